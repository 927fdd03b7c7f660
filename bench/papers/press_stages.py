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
from fingerflow.plot.captions import describe
from fingerflow.plot.outlines import contact_outline, matrix_of_view, to_pixels
from fingerflow.recordings import open_recording
from fingerflow.report.sheet import SheetPanel
from fingerflow.schema.scene import Scene

Picture = NDArray[np.float32]
_PRINTED_RADIUS = 5  # px, radius of the median filter in figure S3 A
_MAGNIFIED = 10  # magnification of displacements in the drawn tracks
_MARGIN_PX = 15  # px, shown around the contact
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
    panels.append(SheetPanel.single("A5", lambda axes: show_contact(axes, result, scene, "contact", frame)))
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
        SheetPanel.single("B3", lambda axes: _points(axes, result, scene, first)),
        SheetPanel.single("B4", lambda axes: _tracks(axes, result, scene, frame)),
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


def show(axes: Axes, picture: NDArray[Any], title: str = "") -> None:
    """Draw an image in grey levels without axis ticks."""
    low, high = np.percentile(picture, (0.5, 99.5)) if picture.dtype != bool else (0, 1)
    axes.imshow(picture, cmap="gray", vmin=low, vmax=max(high, low + 1e-6), interpolation="nearest")
    axes.set(xticks=[], yticks=[], title=title)


def show_contact(axes: Axes, result: xr.Dataset, scene: Scene, view: str, frame: int) -> None:
    """Draw the part of a view around the gross contact in a frame, with the ellipse."""
    show(axes, view_of(scene, view, frame), "ellipse")
    outline = contact_outline(result.isel(frame=frame))
    assert outline is not None
    ring = to_pixels(outline, matrix_of_view(result, view))
    axes.plot(*ring.T, color=YELLOW, linewidth=1)
    (left, top), (right, bottom) = ring.min(0) - _MARGIN_PX, ring.max(0) + _MARGIN_PX
    axes.set(xlim=(left, right), ylim=(bottom, top))


def _empty(scene: Scene) -> Picture:
    with open_recording(scene.background.frames) as recording:
        return np.asarray(scene.views.contact.crop(recording[0]), dtype=np.float32)


def _picture(letter: str, picture: NDArray[Any]) -> SheetPanel:
    number, words = letter.split(", ", 1)
    return SheetPanel.single(number, show, picture, words)


def _points(axes: Axes, result: xr.Dataset, scene: Scene, frame: int) -> None:
    show(axes, view_of(scene, "topography", frame), "points at first contact")
    places = to_pixels(result["position"].values[frame], matrix_of_view(result, "topography"))
    axes.plot(*places.T, ".", color=GREEN, markersize=1)


def _tracks(axes: Axes, result: xr.Dataset, scene: Scene, frame: int) -> None:
    show(axes, view_of(scene, "topography", frame), f"tracks, {_MAGNIFIED} x")
    matrix = matrix_of_view(result, "topography")
    position = result["position"].values[: frame + 1]
    known = np.flatnonzero(np.isfinite(position).all((0, 2)))
    for point in known[:: max(1, len(known) // 150)]:
        track = position[0, point] + _MAGNIFIED * (position[:, point] - position[0, point])
        axes.plot(*to_pixels(track, matrix).T, color=YELLOW, linewidth=0.9)


def difference_panel(pairs: Sequence[tuple[float, NDArray[np.bool_], NDArray[np.bool_]]]) -> SheetPanel:
    """Return the panel of figure S1 E: where skin touches at high but not at low friction (red) and the reverse (blue),
    from triples (normal force in N, contact mask at high and at low friction).
    """

    def draw(part: SubFigure) -> None:
        # The largest contact, without single pixels elsewhere, sets the part that is shown.
        (top, bottom), (left, right) = np.quantile(np.nonzero(pairs[-1][1]), (0.005, 0.995), axis=1).T
        grid = np.atleast_1d(part.subplots(1, len(pairs)))
        for axes, (force, high, low) in zip(grid, pairs, strict=True):
            axes.imshow(high.astype(int) - low, cmap="RdBu_r", vmin=-1, vmax=1, interpolation="nearest")
            axes.set(xticks=[], yticks=[], title=f"{force:g} N")
            axes.set(xlim=(left - _MARGIN_PX, right + _MARGIN_PX), ylim=(bottom + _MARGIN_PX, top - _MARGIN_PX))
        describe(
            grid[0], "Real contact of one press at high friction only (red) and of one at low friction only (blue)."
        )

    return SheetPanel("E, images", draw, columns=2)
