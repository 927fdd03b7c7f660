"""Table of hardware and analysis, as the iDICs Good Practices Guide (Jones & Iadicola 2018) asks for it."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from scipy.spatial import cKDTree

from fingerflow.recordings import open_recording
from fingerflow.schema.scene import Scene
from fingerflow.schema.variables import VARIABLES

Rows = list[tuple[str, str]]
_STRAIN = {"green_lagrange": "Green-Lagrange", "as_printed": "Willemet et al. 2021, equation 1"}


def practice_tables(result: xr.Dataset, scene: Scene | None) -> dict[str, Rows]:
    """Return rows (quantity, value) of the hardware and of the analysis of a result.

    What neither the recording nor the table [rig] of the scene states is listed as "not stated", with the key to state
    it. `scene` is None for a stream, whose recording is gone.
    """
    settings = json.loads(result.attrs["settings"])
    rig = json.loads(scene.as_json())["rig"] if scene is not None else settings.get("rig") or {}
    hardware = [("camera", _stated(rig, "camera"))]
    if scene is not None:
        with open_recording(scene.recording.frames, frame_rate=scene.recording.frame_rate) as recording:
            height, width = recording.frame_shape
            depth = f", {recording.bit_depth} bit" if recording.bit_depth else ""
        hardware.append(("image resolution", f"{width} × {height} px{depth}"))
    hardware += _optics(result, settings, rig)
    return {"Hardware": hardware, "Analysis": _analysis(result, settings, rig)}


def _optics(result: xr.Dataset, settings: Mapping[str, Any], rig: Mapping[str, Any]) -> Rows:
    scale, steps = float(result.attrs["mm_per_px"]), np.diff(result["time"].values)
    rows = [("lens", _stated(rig, "lens")), ("aperture", _stated(rig, "aperture", "f/{:g}"))]
    rows.append(("stand-off distance", _stated(rig, "stand_off_mm", "{:g} mm")))
    for name, (high, wide) in _view_sizes(settings.get("views") or {}).items():
        size = scale * _magnification(result) if name == "topography" else scale
        rows.append((f"field of view, {name}", f"{wide * size:.3g} × {high * size:.3g} mm ({wide} × {high} px)"))
    rows.append(("image scale", f"{scale:.5f} mm/px ({1 / scale:.1f} px/mm)"))
    if len(steps):
        rows.append(("image acquisition rate", f"{1 / float(np.median(steps)):.4g} Hz"))
    noise = _attribute(result, "position_std_px", "image_noise")
    rows.append(("image noise", "not known" if noise is None else f"{noise:.2g} grey levels"))
    period = _attribute(result, "gross_contact_area", "ridge_period_mm")
    spacing = "" if period is None else f", {period:.2f} mm apart ({period / scale:.1f} px), measured"
    rows.append(("pattern", f"skin ridges{spacing}"))
    return rows


def _analysis(result: xr.Dataset, settings: Mapping[str, Any], rig: Mapping[str, Any]) -> Rows:
    engine = f", engine {result.attrs['engine']}" if "engine" in result.attrs else ""
    rows = [("software", f"fingerflow {result.attrs['fingerflow_version']}{engine}")]
    tracking, fields = settings.get("tracking") or {}, settings.get("fields") or {}
    if "position_px" not in result or "window_px" not in tracking:
        return rows
    window, scale = tracking["window_px"], float(result.attrs["mm_per_px"]) * _magnification(result)
    points = int((result["status"].values == 0).sum(1).max())
    by_key = tracking.get("template", "keyframe") == "keyframe"  # a recipe has no other template
    update = "key frame, updated where skin deforms" if by_key else "previous frame"
    free = "up to gain and offset (as ZNSSD)" if tracking["gain_offset"] else "of grey levels (SSD)"
    rows += [
        ("image filtering", "binomial smoothing, part of the interpolant"),
        ("subset", f"{window} × {window} px ({window * scale:.2g} × {window * scale:.2g} mm)"),
        ("step", f"no grid: {points} points at least {tracking['min_distance_px']:g} px apart{_spacing(result)}"),
        ("reference", f"{update}; displacement counts from {_reference(fields)}"),
        ("subset shape function", "affine: gradient from the neighbouring points, translation optimised"),
        ("matching criterion", f"least squares {free}"),
        ("interpolant", "cubic B-spline"),
    ]
    if fields:
        gauge, measure = fields["gauge_length_mm"], str(result.attrs["strain_measure"])
        rows += [
            ("virtual strain gauge", f"{gauge:g} mm ({gauge / scale:.0f} px): planes fitted with bisquare weights"),
            ("strain formulation", f"{_STRAIN.get(measure, measure)}; of triangles from their corners"),
            *_noise_floors(result, rig.get("noise_floor"), window, gauge),
        ]
    return rows


def _noise_floors(result: xr.Dataset, floor: Mapping[str, float] | None, window: int, gauge: float) -> Rows:
    rows = []
    for name, key in (("displacement", "displacement_mm"), ("divergence", "divergence"), ("strain", "strain")):
        variable, text = VARIABLES[name], "not measured: `fingerflow noise-floor` on still frames"
        unit = variable.shown_unit
        if floor is not None and (floor["window_px"], floor["gauge_length_mm"]) != (window, gauge):
            text = "measured with another window or gauge length: measure again"
        elif floor is not None:
            text = f"{unit.factor * floor[key]:.3g} {unit.name}, measured in still frames"
        stated = result[f"{name}_std"].values if f"{name}_std" in result else np.array([])
        if np.isfinite(stated).any():
            text += f" (this result states {unit.factor * float(np.nanmedian(stated)):.2g} {unit.name} in the median)"
        rows.append((f"noise floor, {name}", text))
    return rows


def _reference(fields: Mapping[str, Any]) -> str:
    reference = str(fields.get("reference", "onset"))
    return "the onset of contact of each point" if reference == "onset" else reference.replace("_", " ")


def _view_sizes(views: Mapping[str, Any]) -> dict[str, tuple[int, int]]:
    """Return the size (height, width) px of each view, from the settings of a scene or those of a recipe."""
    if "height" in views:
        return dict.fromkeys(("contact", "topography"), (views["height"], views["width"]))
    # The other names are aliases of this view for stages.
    shown = {"camera": views["camera"]} if "camera" in views else views
    spans = {name: (view["rows"], view["columns"]) for name, view in shown.items()}
    return {name: (rows[1] - rows[0], columns[1] - columns[0]) for name, (rows, columns) in spans.items()}


def _stated(rig: Mapping[str, Any], key: str, form: str = "{}") -> str:
    value = rig.get(key)
    return f"not stated: [rig] {key}" if value is None else form.format(value)


def _attribute(result: xr.Dataset, variable: str, name: str) -> float | None:
    """Return a finite number among the attributes of a variable, or None."""
    value = float(result[variable].attrs.get(name, np.nan)) if variable in result else np.nan
    return value if np.isfinite(value) else None


def _magnification(result: xr.Dataset) -> float:
    """Return the scale between the two views of a frame: the number of contact-view pixels along the side of one pixel
    of the topography view.
    """
    matrix = np.array(json.loads(result.attrs["topography_to_contact"]), dtype=np.float64)
    return float(np.sqrt(abs(np.linalg.det(matrix[:, :2]))))


def _spacing(result: xr.Dataset) -> str:
    """Return a phrase with the median distance (px) from a tracked point to its nearest neighbour, in the frame with
    the most known positions; "" for fewer than three points.
    """
    position = result["position_px"].values
    frame = int(np.isfinite(position).all(-1).sum(1).argmax())
    points = position[frame][np.isfinite(position[frame]).all(-1)]
    if len(points) < 3:
        return ""
    return f", nearest neighbour at {np.median(cKDTree(points).query(points, 2)[0][:, 1]):.1f} px in the median"
