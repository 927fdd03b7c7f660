"""A picture in which a person can judge a calibration by eye."""

from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.patheffects import withStroke
from numpy.typing import ArrayLike, NDArray

from fingerflow.calibration.calibration import Calibration
from fingerflow.calibration.edge import Array, Disc
from fingerflow.calibration.registration import Transform
from fingerflow.errors import FingerflowError

LABELS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
CHECKER_PX = 32


def draw_overlay(path: str | Path, calibration: Calibration, target: ArrayLike | None, ring: ArrayLike) -> None:
    """Write a PNG with what was found drawn over the frames (H, W) that the calibration was made from.

    Above: both views of the target with the discs, and the ring with its hole. Below: the topography view, moved onto
    the contact view, as a colour blend (grey where they agree) and as a chequerboard (edges run on across the squares),
    and every disc enlarged, above in the topography and below in the contact view. Without a target: the ring alone.
    Raises FingerflowError where the file cannot be written.
    """
    contact_view = calibration.views["contact"]
    hole_image = contact_view.crop(np.asarray(ring))
    if target is None or calibration.affine is None or calibration.similarity is None:
        figure = Figure(figsize=(8, 7), layout="constrained")
        _draw_hole(figure.add_subplot(), hole_image, calibration)
    else:
        frame = np.asarray(target)
        images = calibration.views["topography"].crop(frame), contact_view.crop(frame)
        figure = Figure(figsize=(21, 11.5), layout="constrained")
        grid = figure.add_gridspec(2, 3)
        for side, name in enumerate(("topography", "contact")):
            axes = figure.add_subplot(grid[0, side])
            _draw_discs(axes, images[side], [pair[side] for pair in calibration.discs])
            axes.set_title(f"{name} view of the target")
        _draw_hole(figure.add_subplot(grid[0, 2]), hole_image, calibration)
        blend, checker = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
        _draw_blends(blend, checker, images, calibration.affine, calibration.similarity)
        for axes in (blend, checker):
            for _, disc in calibration.discs:
                axes.plot(*disc.center, "+", color="yellow", markersize=8, markeredgewidth=0.8)
        details = grid[1, 2].subgridspec(2, len(calibration.discs))
        for side, image in enumerate(images):
            for index, pair in enumerate(calibration.discs):
                _draw_detail(figure.add_subplot(details[side, index]), image, pair[side], LABELS[index])
    for axes in figure.axes:
        axes.set_axis_off()
    FigureCanvasAgg(figure)
    try:
        figure.savefig(path, format="png", dpi=80)
    except OSError as error:
        raise FingerflowError(f"{path}: the overlay cannot be written: {error}. Give a folder that exists") from error


def _draw_discs(axes: Axes, image: Array, discs: list[Disc]) -> None:
    axes.imshow(_visible(image), cmap="gray", vmin=0, vmax=255)
    for label, disc in zip(LABELS, discs, strict=False):
        _draw_outline(axes, disc)
        x, y = disc.center
        axes.annotate(
            f"{label} ({x:.2f}, {y:.2f}) ± {disc.center_sigma_px:.2f} px",
            (x, y),
            (disc.semi_axes_px[0] + 4, disc.semi_axes_px[0] + 4),
            textcoords="offset pixels",
            color="yellow",
            fontsize=11,
            path_effects=[withStroke(linewidth=3, foreground="black")],
        )


def _draw_hole(axes: Axes, image: Array, calibration: Calibration) -> None:
    hole = calibration.hole
    axes.imshow(_visible(image), cmap="gray", vmin=0, vmax=255)
    _draw_outline(axes, hole)
    axes.set_title(
        f"hole {calibration.hole_radius_mm:g} mm = {hole.radius_px:.2f} px, edge within {hole.edge_rms_px:.2f} px, "
        f"axes {hole.axis_ratio:.3f}:\n{1000 * calibration.mm_per_px:.3f} µm/px"
    )


def _draw_blends(
    blend: Axes, checker: Axes, images: tuple[Array, Array], affine: Transform, similarity: Transform
) -> None:
    height, width = images[1].shape
    moved = cv2.warpAffine(_visible(images[0]), affine.matrix, (width, height), flags=cv2.INTER_LINEAR)
    covered = (
        cv2.warpAffine(np.ones(images[0].shape, np.uint8), affine.matrix, (width, height), flags=cv2.INTER_NEAREST) > 0
    )
    contact = _visible(images[1])
    blend.imshow(np.stack([moved, contact, moved], axis=-1))
    angle = np.degrees(np.arctan2(similarity.matrix[1, 0], similarity.matrix[0, 0]))
    growth = np.hypot(*similarity.matrix[:, 0])
    blend.set_title(
        f"topography (magenta) moved onto contact (green)\nscale {growth:.4f}, rotation {angle:.2f}°, "
        f"similarity within {similarity.rms_px:.2f} px"
    )
    row, column = np.indices((height, width)) // CHECKER_PX
    checker.imshow(np.where(((row + column) % 2 == 0) & covered, moved, contact), cmap="gray", vmin=0, vmax=255)
    checker.set_title(f"squares of {CHECKER_PX} px from the two views in turn")


def _draw_detail(axes: Axes, image: Array, disc: Disc, label: str) -> None:
    reach = 1.7 * disc.semi_axes_px[0]
    x, y = disc.center
    left, top = max(0, int(x - reach)), max(0, int(y - reach))
    part = image[top : int(y + reach) + 1, left : int(x + reach) + 1].astype(np.float64)
    low, high = np.percentile(part, (1, 99))
    axes.imshow(part, cmap="gray", vmin=low, vmax=high, extent=_extent(left, top, part))
    _draw_outline(axes, disc)
    axes.set_title(f"{label}: radius {disc.radius_px:.1f} px\nedge within {disc.edge_rms_px:.2f} px", fontsize=10)


def _extent(left: int, top: int, part: Array) -> tuple[float, float, float, float]:
    height, width = part.shape
    return left - 0.5, left + width - 0.5, top + height - 0.5, top - 0.5


def _draw_outline(axes: Axes, disc: Disc) -> None:
    long, short = disc.semi_axes_px
    outline = Ellipse(disc.center, 2 * long, 2 * short, angle=np.degrees(disc.angle), fill=False, color="red", lw=1)
    axes.add_patch(outline)
    axes.plot(*disc.center, "+", color="yellow", markersize=10, markeredgewidth=1)


def _visible(image: Array) -> NDArray[np.uint8]:
    """8 bits with the uneven light taken out over an eighth of the view; for the eye only."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 0.7)
    light = cv2.GaussianBlur(smooth, (0, 0), max(1.0, min(image.shape) / 8))
    flat = (smooth - light) / (light + 0.05 * float(light.max()) + 1e-9)
    low, high = np.percentile(flat, (0.5, 99.5))
    return np.clip((flat - low) / max(float(high - low), 1e-9) * 255, 0, 255).astype(np.uint8)
