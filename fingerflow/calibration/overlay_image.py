"""Overlay image of detected discs on the frames, for visual inspection of a calibration."""

from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import ArrayLike, NDArray

from fingerflow.calibration.calibration import Calibration
from fingerflow.calibration.edge import Array, Disc
from fingerflow.calibration.registration import Transform

LABELS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
# Approximate width of a label as a share of the view; where it would not fit on the right, it is placed to the left of
# its disc.
LABEL_SHARE = 0.36
# Standard deviation of the blur that removes uneven light, as a share of the shorter side of a view.
LIGHT_SHARE = 1 / 8


def draw_overlay(path: str | Path, calibration: Calibration, target: ArrayLike | None, ring: ArrayLike) -> None:
    """Write a PNG image of the calibration frames (H, W) with the detected discs and the hole.

    Top: both views of the target with the discs, and the ring with its hole. Bottom: the topography view transformed to
    the contact view, as a colour blend (grey where they agree), and every disc enlarged, from the topography above and
    the contact view below. Without a target: the ring alone.
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
        blend = figure.add_subplot(grid[1, 0])
        _draw_blend(blend, images, calibration.affine, calibration.similarity)
        for _, disc in calibration.discs:
            blend.plot(*disc.center, "+", color="yellow", markersize=8, markeredgewidth=0.8)
        details = grid[1, 1:].subgridspec(2, len(calibration.discs))
        for side, name in enumerate(("topography", "contact")):
            for index, pair in enumerate(calibration.discs):
                title = f"{LABELS[index]}, {name}"
                _draw_detail(figure.add_subplot(details[side, index]), images[side], pair[side], title)
    if calibration.warnings:
        figure.suptitle("\n".join(f"warning: {warning}" for warning in calibration.warnings), color="red", fontsize=11)
    for axes in figure.axes:
        axes.set(xticks=[], yticks=[])  # the layout would measure them though they are not drawn
        axes.set_axis_off()
    figure.savefig(path, format="png", dpi=80)


def _draw_discs(axes: Axes, image: Array, discs: list[Disc]) -> None:
    axes.imshow(_flatten_light(image), cmap="gray", vmin=0, vmax=255)
    for label, disc in zip(LABELS, discs, strict=False):
        _draw_outline(axes, disc)
        x, y = disc.center
        right = x < (1 - LABEL_SHARE) * image.shape[1]
        below = y < 3 * disc.semi_axes_px[0]
        axes.annotate(
            f"{label} ({x:.2f}, {y:.2f}) ± {disc.center_sigma_px:.2f} px",
            disc.center,
            (x + disc.semi_axes_px[0] * (0.8 if right else -0.8), y + disc.semi_axes_px[0] * (1 if below else -1)),
            textcoords="data",
            horizontalalignment="left" if right else "right",
            verticalalignment="top" if below else "bottom",
            color="yellow",
            fontsize=12,
            bbox={"facecolor": "black", "alpha": 0.65, "edgecolor": "none", "pad": 1.5},
        )


def _draw_hole(axes: Axes, image: Array, calibration: Calibration) -> None:
    hole = calibration.hole
    axes.imshow(_flatten_light(image), cmap="gray", vmin=0, vmax=255)
    _draw_outline(axes, hole)
    axes.set_title(
        f"{1000 * calibration.mm_per_px:.3f} µm/px: radius of the hole {calibration.hole_radius_mm:g} mm = "
        f"{hole.radius_px:.2f} px\nedge within {hole.edge_rms_px:.2f} px, axes {hole.axis_ratio:.3f} to 1"
    )


def _draw_blend(axes: Axes, images: tuple[Array, Array], affine: Transform, similarity: Transform) -> None:
    topography, contact = (_flatten_light(image) for image in images)
    moved = cv2.warpAffine(topography, affine.matrix, contact.shape[::-1], flags=cv2.INTER_LINEAR)
    axes.imshow(np.stack([moved, contact, moved], axis=-1))
    angle = np.degrees(np.arctan2(similarity.matrix[1, 0], similarity.matrix[0, 0]))
    growth = np.hypot(*similarity.matrix[:, 0])
    axes.set_title(
        f"topography (magenta) moved onto contact (green)\nscale {growth:.4f}, rotation {angle:.2f}°, "
        f"similarity within {similarity.rms_px:.2f} px"
    )


def _draw_detail(axes: Axes, image: Array, disc: Disc, title: str) -> None:
    reach = 1.7 * disc.semi_axes_px[0]
    x, y = disc.center
    left, top = max(0, int(x - reach)), max(0, int(y - reach))
    part = image[top : int(y + reach) + 1, left : int(x + reach) + 1].astype(np.float64)
    low, high = np.percentile(part, (1, 99))
    height, width = part.shape
    extent = (left - 0.5, left + width - 0.5, top + height - 0.5, top - 0.5)
    axes.imshow(part, cmap="gray", vmin=low, vmax=high, extent=extent)
    _draw_outline(axes, disc)
    axes.set_title(f"{title}: radius {disc.radius_px:.1f} px\nedge within {disc.edge_rms_px:.2f} px", fontsize=10)


def _draw_outline(axes: Axes, disc: Disc) -> None:
    long, short = disc.semi_axes_px
    outline = Ellipse(disc.center, 2 * long, 2 * short, angle=np.degrees(disc.angle), fill=False, color="red", lw=1)
    axes.add_patch(outline)
    axes.plot(*disc.center, "+", color="yellow", markersize=10, markeredgewidth=1)


def _flatten_light(image: Array) -> NDArray[np.uint8]:
    """Return an 8-bit image for display, from which slow variations of brightness are removed."""
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 0.7)
    light = cv2.GaussianBlur(smooth, (0, 0), max(1.0, min(image.shape) * LIGHT_SHARE))
    flat = (smooth - light) / (light + 0.05 * float(light.max()) + 1e-9)
    low, high = np.percentile(flat, (0.5, 99.5))
    return np.clip((flat - low) / max(float(high - low), 1e-9) * 255, 0, 255).astype(np.uint8)
