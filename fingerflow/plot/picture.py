"""Image of a frame with results drawn over it: real contact, ellipse, points, scale bar."""

from typing import Any

import numpy as np
import torch
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.graphs import ContactGraph
from fingerflow.ops.filters.illumination import glass_light
from fingerflow.pipeline.stages.preparation.inputs import Inputs, open_inputs
from fingerflow.plot.axes_style import RED, YELLOW, given_or_new
from fingerflow.plot.captions import describe, frame_text
from fingerflow.plot.outlines import Values, contact_outline, matrix_of_view, stuck_outline, to_pixels
from fingerflow.recordings import Recording
from fingerflow.recordings.identity import identity_of
from fingerflow.schema.scene import Scene

MASK, TOUCHING, AWAY, STUCK = "#2f9be0", "#57e07a", "#8fd3ff", "#ff00c8"
_BAR_MM = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
_BAR_SHARE = 0.25  # largest length of a scale bar as a share of the width
_MASK_SHARE = 0.45  # opacity of the colour over pixels in contact
_CONTRAST = (0.5, 99.8)  # percentiles of the grey levels that are drawn black and white


def shown_views(scene: Scene) -> tuple[str, ...]:
    """Return the names of a scene's views; of views that cover the same part of the frame, only the first."""
    if "camera" in scene.views:
        return ("camera",)
    return ("topography", "contact") if scene.views.topography is not None else ("contact",)


def picture(result: xr.Dataset, scene: Scene, frame: int, axes: Axes | None = None, view: str | None = None) -> Axes:
    """Draw one view of a frame with real contact, ellipse of the apparent contact, points and a scale bar.

    Args:
        result: returned by `fingerflow.process` for this scene.
        scene: the scene, whose recording is read.
        frame: index of the frame in the result, from 0.
        axes: axes to draw into; None for a new figure.
        view: "contact", "topography" or "camera"; None for the view that shows the contact.

    Returns:
        The axes, in px of the view. The title has frame, time and force.

    Raises:
        FingerflowError: no such frame or view, or the recording cannot be read.
    """
    names = shown_views(scene)
    name = view or names[-1]
    if name not in names:
        raise FingerflowError(f"view {name!r}: the scene has {', '.join(names)}")
    if not 0 <= frame < result.sizes["frame"]:
        raise FingerflowError(f"frame {frame}: the result has {result.sizes['frame']}, from 0 on")
    inputs = open_inputs(scene, "cpu")
    with inputs.recording:
        check_recording(result, inputs.recording)
        counts = inputs.recording[[frame]].read()
        mask = None if name == "topography" else _mask(result, inputs, frame, counts)
    grey = scene.views[name].crop(counts)[0].astype(np.float64)
    height, width = grey.shape
    axes = given_or_new(axes, height / width + 0.22)
    low, high = np.nanpercentile(grey, _CONTRAST)
    shown = np.repeat(np.clip((grey - low) / max(high - low, 1e-9), 0, 1)[..., None], 3, axis=2)
    if mask is not None and mask.any():
        shown[mask] = (1 - _MASK_SHARE) * shown[mask] + _MASK_SHARE * np.array(to_rgb(MASK))
        axes.plot([], [], "s", color=shown[mask].mean(0), markersize=3.5, label="touches")
    axes.imshow(np.round(255 * shown).astype(np.uint8), interpolation="none")
    data, matrix = result.isel(frame=frame), matrix_of_view(result, name)
    outlines: tuple[tuple[Values | None, dict[str, Any]], ...] = (
        (contact_outline(data), {"color": YELLOW, "label": "gross contact"}),
        (stuck_outline(data), {"color": STUCK, "linestyle": "--", "label": "stuck part"}),
    )
    for outline, style in outlines:
        if outline is not None:
            axes.plot(*to_pixels(np.append(outline, outline[:1], 0), matrix).T, linewidth=1.4, **style)
    _points(axes, result, frame, matrix)
    _scale_bar(axes, 1 / float(np.sqrt(abs(np.linalg.det(matrix[:, :2])))), width, height)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xticks=[], yticks=[])
    axes.set_title(f"{name.capitalize()} view, {frame_text(data)}")
    text = f"The {name} view in {frame_text(data)}. "
    text += "The gross contact is the ellipse of the region which the contact spans."
    if "position" in result:
        text += f" n = {int(np.isfinite(data['position'].values).all(-1).sum())} points with a position."
    describe(axes, text)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(
            frameon=False, loc="upper center", bbox_to_anchor=(0.5, 0), ncols=2, handletextpad=0.3, markerscale=2,
        )  # fmt: skip
    return axes


def _mask(result: xr.Dataset, inputs: Inputs, frame: int, counts: NDArray[np.generic]) -> NDArray[np.bool_] | None:
    scene = inputs.scene
    threshold = float(result["contact_threshold"].values[frame]) if "contact_threshold" in result else np.nan
    if not np.isfinite(threshold):
        return None
    view = scene.views.contact
    graph = ContactGraph(scene.contact.median_px, scene.contact.gross_radius_px)
    with torch.inference_mode():
        light, black = glass_light(inputs.reference(view), inputs.dark(view))
        limit = 1 - torch.full((1,), threshold, dtype=light.dtype)
        contact = graph(inputs.contact_view(counts), light, black, limit)
    return contact.real_contact_mask[0, 0].numpy()


def check_recording(result: xr.Dataset, frames: Recording) -> None:
    """Raise FingerflowError if a result was computed from other frames than those that its scene selects."""
    stated = result.attrs.get("recording")  # missing in results of older versions
    identity = identity_of(frames)
    if stated not in (None, identity):
        raise FingerflowError(
            f"{frames.path}: the result is not of these frames ({identity}), it was computed from "
            f"{result.attrs.get('frames')} ({stated}). Name the scene of the result, or process this scene again"
        )


def _points(axes: Axes, result: xr.Dataset, frame: int, matrix: Values) -> None:
    """Draw the tracked points of a frame onto a view, to which `matrix` maps from mm on the glass; lost points are
    drawn as crosses at their positions in the first frame.
    """
    if "position" not in result:
        return
    now = result["position"].values[frame]
    tracked = np.isfinite(now).all(-1)
    first = result["position"].values[0]
    lost = ~tracked & np.isfinite(first).all(-1)
    touched = result["in_contact"].values[frame] > 0 if "in_contact" in result else tracked
    dot: dict[str, Any] = {"marker": "o", "markersize": 2.2, "markeredgewidth": 0.3, "markeredgecolor": "black"}
    cross: dict[str, Any] = {"marker": "x", "markersize": 3, "markeredgewidth": 0.6}
    for places, shown, style, colour, label in (
        (now, tracked & touched, dot, TOUCHING, "points in contact" if "in_contact" in result else "points"),
        (now, tracked & ~touched, dot, AWAY, "points not in contact"),
        (first, lost, cross, RED, "points lost"),
    ):
        if shown.any():
            axes.plot(*to_pixels(places[shown], matrix).T, linestyle="", color=colour, label=label, **style)


def _scale_bar(axes: Axes, mm_per_px: float, width: int, height: int) -> None:
    """Draw a labelled scale bar: the longest round length that takes at most a quarter of the image width."""
    fitting = [length for length in _BAR_MM if length / mm_per_px <= _BAR_SHARE * width]
    length = fitting[-1] if fitting else _BAR_MM[0]
    right, y = 0.96 * width, 0.95 * height
    left = right - length / mm_per_px
    edge = [withStroke(linewidth=2.5, foreground="black")]
    axes.plot([left, right], [y, y], color="white", linewidth=3, solid_capstyle="butt", label="_scale bar",
              path_effects=[withStroke(linewidth=4.5, foreground="black")])  # fmt: skip
    axes.annotate(f"{length:g} mm", ((left + right) / 2, y), (0, 4), textcoords="offset points", color="white",
                  ha="center", va="bottom", path_effects=edge)  # fmt: skip
