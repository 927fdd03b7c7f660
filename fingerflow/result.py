"""The labelled data set of a trial, and its files: HDF5/NetCDF4, CSV and .mat."""

import json
import math
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import xarray as xr

from fingerflow import __version__
from fingerflow.atomic_write import write_atomically
from fingerflow.errors import FingerflowError
from fingerflow.ops.tracking import TrackStatus
from fingerflow.stages.contact import ContactSeries
from fingerflow.stages.deformation import (
    Displacement,
    FieldSeries,
    StrainSeries,
    glass_positions,
    nanmedian,
    rate,
)
from fingerflow.stages.inputs import Inputs
from fingerflow.stages.loading import Loading
from fingerflow.stages.slip import SlipSeries
from fingerflow.stages.tracking import TrackSeries


@dataclass
class Outcome:
    """What the stages of a trial have given so far."""

    inputs: Inputs
    seconds: dict[str, float]
    loading: Loading | None = None
    contact: ContactSeries | None = None
    tracks: TrackSeries | None = None
    displacement: Displacement | None = None
    fields: FieldSeries | None = None
    strain: StrainSeries | None = None
    slip: SlipSeries | None = None
    variables: dict[str, tuple[tuple[str, ...], Any, dict[str, Any]]] = field(default_factory=dict)

    def add(self, name: str, dims: tuple[str, ...], values: Any, units: str, long_name: str, **attrs: Any) -> None:
        self.variables[name] = (dims, values, {"units": units, "long_name": long_name, **attrs})


def label(outcome: Outcome) -> xr.Dataset:
    """The results with names, dimensions, coordinates, units and provenance."""
    inputs, scene = outcome.inputs, outcome.inputs.scene
    for given in (_loading, _contact, _tracks, _displacement, _fields, _strain, _slip):
        given(outcome)
    coordinates: dict[str, Any] = {
        "time": ("frame", inputs.times, {"units": "s", "long_name": "time from the trigger, or from the first frame"}),
        "frame": np.arange(len(inputs.times)) + scene.recording.first_frame,
        "xy": ["x", "y"],
        "axis": ["major", "minor"],
        "strain_component": ["exx", "eyy", "exy"],
    }
    used = {name for dims, _, _ in outcome.variables.values() for name in dims} | {"frame", "time"}
    return xr.Dataset(
        outcome.variables,
        coords={name: value for name, value in coordinates.items() if name in used},
        attrs={
            "title": "fingertip on glass",
            "fingerflow_version": __version__,
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "settings": scene.as_json(),
            "strain_measure": scene.fields.strain,
            "warnings": json.dumps(inputs.warnings),
            "stage_seconds": json.dumps({name: round(value, 4) for name, value in outcome.seconds.items()}),
            "mm_per_px": inputs.mm_per_px,
            "topography_to_contact": json.dumps(inputs.topography_to_contact.tolist()),
            "frames": str(scene.recording.frames),
        },
    )


def _loading(outcome: Outcome) -> None:
    if outcome.loading is None:
        return
    outcome.add("normal_force", ("frame",), outcome.loading.normal, "N", "normal force")
    if outcome.loading.ratio is not None:
        outcome.add("load_ratio", ("frame",), outcome.loading.ratio, "1", "tangential over normal force, T/N")
    if outcome.loading.tangential is not None:
        outcome.add("tangential_force", ("frame",), outcome.loading.tangential, "N", "tangential force")


def _contact(outcome: Outcome) -> None:
    contact = outcome.contact
    if contact is None:
        return
    outcome.add(
        "contact_threshold", ("frame",), contact.threshold, "1", "relative intensity loss that counts as contact"
    )
    outcome.add("real_contact_area", ("frame",), contact.real_area, "mm2", "area of the micro-junctions")
    outcome.add(
        "gross_contact_area", ("frame",), contact.gross_area, "mm2", "area of the region that the contact spans"
    )
    outcome.add("ellipse_center", ("frame", "xy"), contact.center, "mm", "centre of the gross contact on the glass")
    outcome.add("ellipse_semi_axes", ("frame", "axis"), contact.semi_axes, "mm", "semi-axes of the gross contact")
    outcome.add("ellipse_angle", ("frame",), contact.angle, "rad", "major axis of the gross contact, from x towards y")


def _tracks(outcome: Outcome) -> None:
    tracks = outcome.tracks
    if tracks is None:
        return
    point = ("frame", "point")
    position = glass_positions(outcome.inputs, tracks.position)
    outcome.add("position", (*point, "xy"), position, "mm", "position on the glass")
    outcome.add("position_px", (*point, "xy"), tracks.position, "px", "position in the topographic view")
    outcome.add(
        "position_std_px", point, tracks.position_std, "px", "standard deviation of a component of the position"
    )
    outcome.add("forward_backward_error", point, tracks.error, "px", "distance after tracking forward and back")
    outcome.add(
        "status",
        point,
        tracks.status,
        "1",
        "why a point has a position, or none",
        flag_values=np.array([int(status) for status in TrackStatus], dtype=np.uint8),
        flag_meanings=" ".join(status.name.lower() for status in TrackStatus),
    )
    tracked = tracks.status == TrackStatus.TRACKED
    share = tracked.sum(1) / tracked.shape[1] if tracked.shape[1] else np.full(len(tracked), np.nan)
    outcome.add("tracked_share", ("frame",), share, "1", "share of the points that are tracked")
    median = nanmedian(np.where(tracked, tracks.error, np.nan))
    outcome.add("forward_backward_median", ("frame",), median, "px", "median forward-backward distance")


def _displacement(outcome: Outcome) -> None:
    moved = outcome.displacement
    if moved is None:
        return
    onset = np.where(moved.onset < 0, -1, moved.onset + outcome.inputs.scene.recording.first_frame)
    outcome.add(
        "onset_frame", ("point",), onset, "1", "first frame in which the contact comes to cover the point, -1 for never"
    )
    outcome.add(
        "reference_position",
        ("point", "xy"),
        moved.reference,
        "mm",
        "position at onset; of points that are touched in passing alone, where they were then",
    )
    outcome.add("displacement", ("frame", "point", "xy"), moved.displacement, "mm", "displacement since onset")
    outcome.add(
        "displacement_std",
        ("frame", "point"),
        moved.displacement_std(),
        "mm",
        "standard deviation of a component since onset",
    )
    outcome.add("global_displacement_vector", ("frame", "xy"), moved.vector, "mm", "median displacement, by component")
    outcome.add(
        "global_displacement",
        ("frame",),
        np.linalg.norm(moved.vector, axis=1),
        "mm",
        "length of the median displacement",
    )


def _fields(outcome: Outcome) -> None:
    fields = outcome.fields
    if fields is None:
        return
    settings = outcome.inputs.scene.fields
    point = ("frame", "point")
    gauge = {"gauge_length_mm": settings.gauge_length_mm}
    deviation = "standard deviation of the"
    outcome.add("divergence", point, fields.divergence, "1", "divergence of the displacement", **gauge)
    outcome.add("curl", point, fields.curl, "rad", "curl of the displacement", **gauge)
    outcome.add("divergence_std", point, fields.divergence_std, "1", f"{deviation} divergence", **gauge)
    outcome.add("curl_std", point, fields.curl_std, "rad", f"{deviation} curl", **gauge)
    over = "over the area of the gross contact"
    times, window = outcome.inputs.times, settings.rate_window_s
    frame, component = ("frame",), ("frame", "strain_component")
    for name, unit, dims, columns in (
        ("divergence", "1", frame, 0),
        ("curl", "rad", frame, 1),
        ("strain", "1", component, slice(2, 5)),
    ):
        measure = {"measure": settings.strain} if name == "strain" else {}
        median = fields.median[:, columns]
        outcome.add(f"median_{name}", dims, median, unit, f"median {name} {over}", **gauge, **measure)
        outcome.add(f"median_{name}_std", dims, fields.median_std[:, columns], unit, f"{deviation} median {name}")
        if name != "curl":
            outcome.add(f"median_{name}_rate", dims, rate(median, times, window), "1/s", f"rate of median_{name}")


def _strain(outcome: Outcome) -> None:
    strain = outcome.strain
    if strain is None:
        return
    settings = outcome.inputs.scene.fields
    triangle = ("frame", "triangle")
    outcome.add("triangles", ("triangle", "corner"), strain.triangles, "1", "points at the corners of a triangle")
    outcome.add(
        "strain", (*triangle, "strain_component"), strain.strain, "1", "strain of a triangle", measure=settings.strain
    )
    outcome.add(
        "strain_std", (*triangle, "strain_component"), strain.strain_std, "1", "standard deviation of the strain"
    )
    outcome.add("strain_energy_density", triangle, strain.density, "mJ/mm3", "strain energy density, plane strain")
    depth = {"depth_mm": settings.depth_mm}
    name = "strain energy of the skin in contact, without that of noise"
    outcome.add("strain_energy", ("frame",), strain.energy, "mJ", name, **depth)
    name = "standard deviation of strain_energy"
    outcome.add("strain_energy_std", ("frame",), strain.energy_std, "mJ", name, **depth)
    rates = rate(strain.energy, outcome.inputs.times, settings.rate_window_s)
    outcome.add("strain_energy_rate", ("frame",), rates, "mJ/s", "rate of strain_energy")


def _slip(outcome: Outcome) -> None:
    slip = outcome.slip
    if slip is None:
        return
    frame, limit = ("frame",), {"stuck_mm": outcome.inputs.scene.slip.stuck_mm}
    outcome.add("stuck_area", frame, slip.stuck_area, "mm2", "area of the contact whose skin has not slipped", **limit)
    judged = {
        name: json.dumps(_plain(asdict(part)), ensure_ascii=False)
        for name, part in (("verdict", slip.verdict), ("friction_fit", slip.fit), ("curves", slip.curves))
        if part is not None
    }
    name = "stuck area over gross contact area, d²"
    outcome.add("stuck_ratio", frame, slip.stuck_ratio, "1", name, **limit, **judged)
    cells = ("frame", "cell_row", "cell_column")
    size = {
        "cell_mm": slip.cell_px * outcome.inputs.mm_per_px,
        "first_cell_mm": (slip.cell_px - 1) / 2 * outcome.inputs.mm_per_px,
    }
    outcome.add("stuck_region", cells, slip.region.astype(np.uint8), "1", "1 where the skin has not slipped", **size)
    name = "share of the gross contact that the windows of tracked points show"
    outcome.add("slip_coverage", frame, slip.coverage, "1", name)


def _plain(value: Any) -> Any:
    """What JSON can say: null for NaN."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def save_result(result: xr.Dataset, path: Path) -> None:
    """Writes HDF5/NetCDF4; the file appears only when it is complete."""
    compressed = {name: {"zlib": True, "complevel": 2} for name, values in result.data_vars.items() if values.ndim > 1}
    write_atomically(path, lambda part: result.to_netcdf(part, engine="h5netcdf", encoding=compressed))


def load_result(path: Path) -> xr.Dataset:
    """Reads what :func:`save_result` wrote. Raises FingerflowError where the file is missing or is something else."""
    try:
        with xr.open_dataset(path, engine="h5netcdf") as stored:
            result = stored.load()
    except (OSError, ValueError) as error:
        raise FingerflowError(f"{path} cannot be read as a result ({error}); run `fingerflow process` first") from error
    if "fingerflow_version" not in result.attrs:
        raise FingerflowError(f"{path} is not a result of fingerflow: it does not state a fingerflow_version")
    return result


def export_table(result: xr.Dataset, path: Path) -> None:
    """Writes a table: .csv with one row a frame and one column a quantity, or .mat with every variable.

    Raises FingerflowError for another suffix.
    """
    if path.suffix == ".csv":
        columns = {}
        for name, values in {"time": result["time"], **result.data_vars}.items():
            if values.dims == ("frame",):
                columns[f"{name} ({values.attrs['units']})"] = values.values
            elif (
                len(values.dims) == 2
                and values.dims[0] == "frame"
                and values.dims[1] in ("xy", "axis", "strain_component")
            ):
                for k, part in enumerate(result[values.dims[1]].values):
                    columns[f"{name}_{part} ({values.attrs['units']})"] = values.values[:, k]
        rows = np.column_stack([result["frame"].values, *columns.values()])
        header = ",".join(["frame", *columns])
        write_atomically(
            path, lambda part: np.savetxt(part, rows, delimiter=",", fmt="%.9g", header=header, comments="")
        )
    elif path.suffix == ".mat":
        content: dict[str, Any] = {str(name): values.values for name, values in result.data_vars.items()}
        content["time"] = result["time"].values
        content["frame"] = result["frame"].values
        content["units"] = {str(name): values.attrs["units"] for name, values in result.data_vars.items()}

        def write(part: Path) -> None:
            with part.open("wb") as file:
                scipy.io.savemat(file, content, do_compression=True, long_field_names=True)

        write_atomically(path, write)
    else:
        raise FingerflowError(f"{path}: a table is written as .csv or .mat, not {path.suffix or 'without a suffix'!r}")
