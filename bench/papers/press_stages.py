"""Figure S3 of Willemet et al. 2021: a frame of a press at each stage of the processing."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from numpy.typing import NDArray

from fingerflow import plot
from fingerflow.plot.axes_style import GREEN, YELLOW
from fingerflow.plot.outlines import matrix_of_view, to_pixels
from fingerflow.recordings import open_recording
from fingerflow.report.sheet import SheetPanel
from fingerflow.schema.scene import Scene

Picture = NDArray[np.float32]
_PRINTED_RADIUS = 5  # px, radius of the median filter in figure S3 A
_MAGNIFIED = 10  # magnification of displacements in the drawn tracks
_BLUR_PX = 21  # px, side of the local mean that is subtracted for the enhanced image


def contact_stages(result: xr.Dataset, scene: Scene, frame: int) -> list[SheetPanel]:
    """Return panels A1 to A6 of figure S3: steps of the contact view, from raw frame to area against force."""
    raw = view_of(scene, "contact", frame)
    light = _empty(scene)
    share = np.divide(raw, light, out=np.ones_like(raw), where=light > 0.1 * light.max()).astype(np.float32)
    signal = np.clip(255 * (1 - share), 0, 255).astype(np.uint8)
    filtered = cv2.medianBlur(signal, 2 * _PRINTED_RADIUS + 1)
    touching = contact_mask(result, scene, frame)
    pictures = {
        "A1, raw": raw,
        "A2, over the empty glass": share.clip(0, 1.2),
        "A3, contact signal, median of radius 5": filtered,
        "A4, binarised": touching,
    }
    panels = [_picture(letter, one) for letter, one in pictures.items()]
    panels.append(SheetPanel.single("A5, ellipse", lambda axes: plot.picture(result, scene, frame, axes, "contact")))
    panels.append(SheetPanel.single("A6", lambda axes: plot.contact_area(result, axes, "normal_force")))
    return panels


def skin_stages(result: xr.Dataset, scene: Scene, frame: int, first: int) -> list[SheetPanel]:
    """Return panels B1 to B6 of figure S3: steps of the topographic view, from raw frame to divergence against force.

    `first` is the frame in which points are shown at first contact.
    """
    raw = view_of(scene, "topography", frame)
    enhanced = raw - cv2.blur(raw, (_BLUR_PX, _BLUR_PX))
    enhanced += enhanced - cv2.GaussianBlur(enhanced, (0, 0), 1.5)
    return [
        _picture("B1, raw", raw),
        _picture("B2, contrast, sharpened", enhanced),
        SheetPanel.single("B3, points at first contact", lambda axes: _points(axes, result, scene, first)),
        SheetPanel.single(f"B4, tracks, {_MAGNIFIED} x", lambda axes: _tracks(axes, result, scene, frame)),
        SheetPanel.single("B5", lambda axes: plot.field_map(result, "divergence", frame, axes)),
        SheetPanel.single("B6", lambda axes: plot.median_divergence(result, axes, "normal_force")),
    ]


def view_of(scene: Scene, name: str, frame: int) -> Picture:
    """Return one view of a frame in grey levels."""
    with open_recording(scene.recording.frames, frame_rate=scene.recording.frame_rate) as recording:
        return np.asarray(scene.views[name].crop(recording[frame]), dtype=np.float32)


def contact_mask(result: xr.Dataset, scene: Scene, frame: int, median_px: int | None = None) -> NDArray[np.bool_]:
    """Return the mask (H, W) of contact-view pixels in which the skin touches the glass in a frame, found by a
    threshold of darkness after a median filter of `median_px` pixels.

    There, the frame is darker than the threshold of the result, relative to a frame of the empty glass. The median is
    that of the scene, unless `median_px` states another.
    """
    light = _empty(scene)
    share = view_of(scene, "contact", frame) / np.maximum(light, 1e-6)
    levels = np.clip(np.round(200 * share), 0, 255).astype(np.uint8)
    filtered = cv2.medianBlur(levels, median_px or scene.contact.median_px)
    dark = filtered < 200 * (1 - float(result["contact_threshold"][frame]))
    return np.asarray(dark & (light > 0.1 * light.max()))


def show(axes: Axes, picture: NDArray[Any]) -> Axes:
    """Draw an image in grey levels without axis ticks, and return the axes."""
    low, high = np.percentile(picture, (0.5, 99.5)) if picture.dtype != bool else (0, 1)
    axes.imshow(picture, cmap="gray", vmin=low, vmax=max(high, low + 1e-6), interpolation="nearest")
    axes.set(xticks=[], yticks=[])
    return axes


def _empty(scene: Scene) -> Picture:
    with open_recording(scene.background.frames) as recording:
        return np.asarray(scene.views.contact.crop(recording[0]), dtype=np.float32)


def _picture(letter: str, picture: NDArray[Any]) -> SheetPanel:
    return SheetPanel(letter, lambda part: show(part.subplots(), picture))


def _points(axes: Axes, result: xr.Dataset, scene: Scene, frame: int) -> Axes:
    show(axes, view_of(scene, "topography", frame))
    places = to_pixels(result["position"].values[frame], matrix_of_view(result, "topography"))
    axes.plot(*places.T, ".", color=GREEN, markersize=2)
    return axes


def _tracks(axes: Axes, result: xr.Dataset, scene: Scene, frame: int) -> Axes:
    show(axes, view_of(scene, "topography", frame))
    matrix = matrix_of_view(result, "topography")
    position = result["position"].values[: frame + 1]
    known = np.flatnonzero(np.isfinite(position).all((0, 2)))
    for point in known[:: max(1, len(known) // 150)]:
        track = position[0, point] + _MAGNIFIED * (position[:, point] - position[0, point])
        axes.plot(*to_pixels(track, matrix).T, color=YELLOW, linewidth=0.9)
    return axes


def difference_panel(pairs: Sequence[tuple[float, NDArray[np.bool_], NDArray[np.bool_]]]) -> SheetPanel:
    """Return the panel of figure S1 E: where skin touches at high but not at low friction (red) and the reverse (blue),
    from triples (normal force in N, contact mask at high and at low friction).
    """

    def draw(part: SubFigure) -> None:
        for axes, (force, high, low) in zip(np.atleast_1d(part.subplots(1, len(pairs))), pairs, strict=True):
            axes.imshow(high.astype(int) - low, cmap="RdBu_r", vmin=-1, vmax=1, interpolation="nearest")
            axes.set(xticks=[], yticks=[], title=f"{force:g} N")

    return SheetPanel("E, high (red) less low friction (blue)", draw, columns=2)
