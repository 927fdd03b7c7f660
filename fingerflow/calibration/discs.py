"""Detect the dark discs of a target and the hole of the scale ring, even under uneven light."""

import cv2
import numpy as np
from numpy.typing import ArrayLike

from fingerflow.calibration.edge import Array, Disc, fit_disc
from fingerflow.errors import FingerflowError

# Smallest and largest radii searched, as shares of the shorter side of the view. The discs of the lab's target have
# 0.045 to 0.06, its ring has 0.156.
DISC_RADII = (0.015, 0.15)
HOLE_RADII = (0.05, 0.45)
# Radii in px of the rings that are searched on each reduced image: one octave, as a larger ring is one of these on an
# image reduced further.
RING_RADII_PX = tuple(6 * 2 ** (step / 4) for step in range(4))
# Least mean agreement of the brightness gradient with the outward direction: 1 is a perfect disc, 0 is chance.
LEAST_AGREEMENT = 0.4
MOST_CANDIDATES = 16
# Limits for a fit to count as a disc. On the lab's frames the true discs have a coverage of 0.98 to 1, an edge RMS of
# at most 0.04 of the radius and a significance of 17 to 41; texture reaches 8.
LEAST_COVERAGE = 0.75
LEAST_AXIS_RATIO = 0.6
MOST_EDGE_RMS = 0.07
LEAST_SIGNIFICANCE = 10.0


def find_discs(view_image: ArrayLike, background: ArrayLike | None = None, count: int = 3) -> list[Disc]:
    """Return at most `count` dark discs in a view (H, W), those with the most significant brightness step first.

    Only the direction of the brightness gradient votes, so a disc in the shade counts as much as one in the light and
    no illumination needs to be divided out. `background`, the view without the target, is therefore not divided by: its
    lamp is another one, and most of it is black. A round dark object that is also in the background belongs to the rig
    and is left out. Raises FingerflowError for an image that is not (H, W) or not finite.
    """
    return _find_dark_discs(view_image, background, DISC_RADII)[:count]


def find_hole(view_image: ArrayLike, background: ArrayLike | None = None) -> Disc:
    """Return the hole of the scale ring in a view (H, W): the large dark disc with the most significant brightness
    step.

    Its `axis_ratio` shows how obliquely the ring is imaged; its `radius_px` is that of the circle of equal area.
    Raises FingerflowError if there is none; for `background` and other errors see `find_discs`.
    """
    holes = _find_dark_discs(view_image, background, HOLE_RADII)
    if not holes:
        raise FingerflowError(
            f"no hole of a ring was found: a dark disc on a brighter ring, all of it inside the view, its radius "
            f"{HOLE_RADII[0]} to {HOLE_RADII[1]} of its shorter side. Check the frame and the pixel ranges of the view"
        )
    return holes[0]


def _find_dark_discs(view_image: ArrayLike, background: ArrayLike | None, radii: tuple[float, float]) -> list[Disc]:
    """Return all dark discs whose radius lies between two given fractions of the shorter side of the view."""
    image = _grey_levels(view_image, "the view")
    empty = None if background is None else _grey_levels(background, "the background of the view")
    if empty is not None and empty.shape != image.shape:
        raise FingerflowError(
            f"the background of the view is {empty.shape} and the view is {image.shape}: crop both with the same View"
        )
    smallest = max(radii[0] * min(image.shape), RING_RADII_PX[0])
    largest = radii[1] * min(image.shape)
    discs: list[Disc] = []
    for center, radius in _candidates(image, smallest, largest):
        disc = fit_disc(image, center, radius)
        if disc and _is_disc(disc) and smallest <= disc.radius_px <= largest and not _is_in_background(empty, disc):
            discs.append(disc)
    discs.sort(key=lambda disc: -disc.significance)
    separate: list[Disc] = []
    for disc in discs:
        if all(_distance(disc, kept_disc) > max(disc.radius_px, kept_disc.radius_px) for kept_disc in separate):
            separate.append(disc)
    return separate


def _grey_levels(image: ArrayLike, name: str) -> Array:
    levels = np.asarray(image, dtype=np.float64)
    if levels.ndim != 2 or 0 in levels.shape:
        raise FingerflowError(f"{name} has the shape {levels.shape}; one grey image (height, width) is needed")
    if not np.isfinite(levels).all():
        raise FingerflowError(f"{name} has {np.sum(~np.isfinite(levels))} pixels that are NaN or infinite; none may be")
    return levels


def _is_disc(disc: Disc) -> bool:
    return (
        disc.coverage >= LEAST_COVERAGE
        and disc.axis_ratio >= LEAST_AXIS_RATIO
        and disc.edge_rms_px <= MOST_EDGE_RMS * disc.radius_px
        and disc.significance >= LEAST_SIGNIFICANCE
    )


def _is_in_background(background: Array | None, disc: Disc) -> bool:
    """Return whether the image `background` shows a disc of the same position and size; False without a background."""
    if background is None:
        return False
    same = fit_disc(background, disc.center, disc.radius_px)
    return (
        same is not None
        and _is_disc(same)
        and _distance(same, disc) < 0.25 * disc.radius_px
        and 0.8 < same.radius_px / disc.radius_px < 1.25
    )


def _distance(first: Disc, second: Disc) -> float:
    return float(np.hypot(first.center[0] - second.center[0], first.center[1] - second.center[1]))


def _candidates(image: Array, smallest: float, largest: float) -> list[tuple[tuple[float, float], float]]:
    """Return circles (centre, radius) px that are darker inside than outside in most directions, the best first."""
    spread = float(np.ptp(image))
    if spread == 0:
        return []
    levels = ((image - image.min()) / spread).astype(np.float32)
    votes: list[tuple[float, float, float, float]] = []
    reduction = 1
    while RING_RADII_PX[0] * reduction <= largest and min(image.shape) // reduction >= 2 * RING_RADII_PX[0]:
        radii = [
            radius
            for radius in RING_RADII_PX
            if smallest <= radius * reduction * 2**0.25 and radius * reduction <= largest
        ]
        if radii:
            votes += _hough_circles(levels, reduction, radii)
        reduction *= 2
    # Chance agreement does not depend on the radius, but texture agrees mostly with small circles.
    votes.sort(key=lambda vote: -vote[0] * np.sqrt(vote[3]))
    best: list[tuple[tuple[float, float], float]] = []
    for _, x, y, radius in votes:
        if len(best) == MOST_CANDIDATES:
            break
        if not any(
            np.hypot(x - x2, y - y2) < 0.5 * max(radius, radius2) and 0.6 < radius / radius2 < 1.7
            for (x2, y2), radius2 in best
        ):
            best.append(((x, y), radius))
    return best


def _hough_circles(levels: Array, reduction: int, radii: list[float]) -> list[tuple[float, float, float, float]]:
    """Return circles (agreement, x, y, radius) along which brightness rises outwards in an image reduced by the factor
    `reduction`, for given radii; agreement, at most 1, tells how uniformly it does.

    They are found by a Hough transform, and x, y and radius are in px of the image before reduction.
    """
    height, width = levels.shape[0] // reduction, levels.shape[1] // reduction
    # Whole blocks only, so that a reduced pixel is the mean of reduction x reduction pixels.
    blocks = levels[: height * reduction, : width * reduction].reshape(height, reduction, width, reduction)
    reduced = blocks.mean(axis=(1, 3))
    # Slow variation, over distances larger than the largest ring, is uneven illumination and not a disc.
    image = cv2.GaussianBlur(reduced, (0, 0), 1.2) - cv2.GaussianBlur(reduced, (0, 0), RING_RADII_PX[-1])
    slope_x, slope_y = cv2.Sobel(image, cv2.CV_32F, 1, 0), cv2.Sobel(image, cv2.CV_32F, 0, 1)
    steepness = np.hypot(slope_x, slope_y)
    # The median is the slope of texture and noise: gradients below it get little weight, those above it equal weight.
    length = np.hypot(steepness, np.median(steepness)) + 1e-7
    slope_x, slope_y = slope_x / length, slope_y / length
    votes = []
    for radius in radii:
        ring_x, ring_y = _ring(radius)
        agreement = cv2.filter2D(slope_x, -1, ring_x, borderType=cv2.BORDER_CONSTANT)
        agreement = agreement + cv2.filter2D(slope_y, -1, ring_y, borderType=cv2.BORDER_CONSTANT)
        highest = cv2.dilate(agreement, np.ones((7, 7), np.uint8))
        for row, column in np.argwhere((agreement == highest) & (agreement > LEAST_AGREEMENT)):
            x, y = ((float(index) + 0.5) * reduction - 0.5 for index in (column, row))
            votes.append((float(agreement[row, column]), x, y, radius * reduction))
    return votes


def _ring(radius: float) -> tuple[Array, Array]:
    """Return two ring-shaped filter kernels that, applied to the x and the y slopes of an image and summed, give the
    mean outward slope along a circle of a given radius, px.
    """
    width = 0.12 * radius
    reach = int(np.ceil(radius + 3 * width))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(np.float64)
    distance = np.hypot(x, y)
    weight = np.exp(-(((distance - radius) / width) ** 2) / 2)
    weight /= weight.sum() * np.where(distance > 0, distance, 1)
    return weight * x, weight * y
