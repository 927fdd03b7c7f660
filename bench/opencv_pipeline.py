"""Pipeline from frames to contact and strain with OpenCV, NumPy and SciPy, for comparison with `fingerflow.process`.

Every choice was the one with the least error against the truth among those tried on the simulated press:

- Real contact: median 3 x 3 (none 10 %, 5 x 5 1.1 %), threshold by Otsu within the gross contact of the last frame
  (0.6 %; within the lit disc 2.5 %).
- Gross contact: micro-junctions closed by one distance between ridges, the largest component, its convex hull (1.3 %;
  without the hull 3.2 to 3.7 %, whatever the closing). Contacts here are convex, which a hull takes for granted.
- Tracking: from the first frame, warped by the affine motion found so far, bilinear; window 21 px, 1 level (0.064 px in
  the last frame). Without the warp the best window is 15 px (0.12 px), from frame to frame or with a new keyframe every
  5 to 30 frames it is no better (0.13 px), and more levels change nothing but double the time.
- Gradients: least-squares planes over the gauge length, all points and frames as matrix products; medians over a grid
  of positions in the contact, each with the field of the nearest point (as medians over the points they are worse).
"""

import time
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from bench.trackers import lucas_kanade

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

_LIT = 0.05  # of full light, where a quotient means anything
_LEVELS = 204.0  # grey levels for all the light, and a quarter of it above
_WINDOW = 21
_GRID_MM = 0.15
_LEAST_POINTS = 5


class Rig(NamedTuple):
    """Inputs of the pipeline: empty glass and darkness (H, W) float32 of the contact view, scale, views, settings."""

    empty: NDArray[np.float32]
    dark: NDArray[np.float32]
    mm_per_px: float
    topography_to_contact: Floats
    points: int = 700
    gauge_mm: float = 1.6


class Measured(NamedTuple):
    """Results of a pipeline by frame, and the seconds that its parts took.

    Areas (F,) mm^2, semi-axes (F, 2) mm, positions (F, N, 2) px of the topography view, divergence (F, N) at them, its
    median (F,) and median strain (F, 3) as (exx, eyy, exy); NaN where unknown.
    """

    real_area: Floats
    gross_area: Floats
    semi_axes: Floats
    position: Floats
    divergence: Floats
    median_divergence: Floats
    median_strain: Floats
    seconds: Mapping[str, float]


class Outline(NamedTuple):
    """Gross contact: mask of its convex hull, 0 or 1, centre (2,) px, and semi-axes with their directions."""

    mask: Image
    center: Floats
    semi_axes: Floats
    directions: Floats


def run(contact: Image, topography: Image, rig: Rig) -> Measured:
    """Measure both views (F, H, W) of a recording whose last frame has the most contact."""
    start = time.perf_counter()
    finder = ContactFinder(contact[-1], rig)
    areas, outlines = zip(*map(finder.find, contact), strict=True)
    found = time.perf_counter()
    position, covered = _follow(topography, outlines, rig)
    followed = time.perf_counter()
    fields = _fields(position, covered, outlines, rig)
    seconds = {"contact": found - start, "tracking": followed - found, "deformation": time.perf_counter() - followed}
    gross_area = np.array([cv2.countNonZero(outline.mask) for outline in outlines])
    semi_axes = np.stack([outline.semi_axes for outline in outlines])
    scale = rig.mm_per_px
    return Measured(np.array(areas) * scale**2, gross_area * scale**2, semi_axes * scale, position, *fields, seconds)


def _follow(frames: Image, outlines: Sequence[Outline], rig: Rig) -> tuple[Floats, NDArray[np.bool_]]:
    """Return positions (F, N, 2) px and which points (F, N) the contact covers."""
    tracker = _Tracker(frames[0], outlines[-1].mask, rig)
    positions, covered = [], []
    for frame, outline in zip(frames, outlines, strict=True):
        positions.append(tracker.follow(frame))
        covered.append(_sample(outline.mask, tracker.last, rig) > 0)
    return np.stack(positions), np.stack(covered)


class ContactFinder:
    """Contact by thresholds, which come from the frame (H, W) with the most contact."""

    def __init__(self, most: Image, rig: Rig) -> None:
        self._dark = rig.dark
        self._light = rig.empty - rig.dark
        self._unlit = self._light <= _LIT * np.quantile(self._light, 0.99)
        quotient = self._quotient(most)
        self._coarse = _otsu(quotient, ~self._unlit)
        self._fine = _otsu(quotient, _gross(quotient, self._coarse).mask > 0)

    def find(self, frame: Image) -> tuple[int, Outline]:
        """Return the real contact area in px and the gross contact."""
        quotient = self._quotient(frame)
        return int(np.count_nonzero(quotient < self._fine)), _gross(quotient, self._coarse)

    def _quotient(self, frame: Image) -> NDArray[np.float32]:
        """Return the light over that of the empty glass, median-filtered."""
        quotient = cv2.divide(cv2.subtract(frame, self._dark, dtype=cv2.CV_32F), self._light)
        quotient[self._unlit] = 1
        return np.asarray(cv2.medianBlur(quotient, 3), dtype=np.float32)


def _otsu(quotient: NDArray[np.float32], where: NDArray[np.bool_]) -> float:
    """Return the quotient below which a pixel is in contact."""
    levels = np.clip(np.round(_LEVELS * quotient), 0, 255).astype(np.uint8)
    level, _ = cv2.thresholdWithMask(
        levels, np.zeros_like(levels), where.astype(np.uint8), 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU
    )
    return (level + 0.5) / _LEVELS


def _gross(quotient: NDArray[np.float32], threshold: float) -> Outline:
    radius = 8
    touching = (quotient < threshold).view(np.uint8)
    element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
    closed = cv2.morphologyEx(touching, cv2.MORPH_CLOSE, element)
    mask = np.zeros(closed.shape, dtype=np.uint8)
    contours, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if contours:
        cv2.fillPoly(mask, [cv2.convexHull(max(contours, key=cv2.contourArea))], 1)
    moments = cv2.moments(mask, binaryImage=True)
    if moments["m00"] < 16:  # a speck
        return Outline(np.zeros_like(mask), np.full(2, np.nan), np.full(2, np.nan), np.eye(2))
    covariance = np.array([[moments["mu20"], moments["mu11"]], [moments["mu11"], moments["mu02"]]]) / moments["m00"]
    variances, directions = np.linalg.eigh(covariance)
    center = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
    return Outline(mask, center, 2 * np.sqrt(variances[::-1]), directions[:, ::-1])


class _Tracker:
    def __init__(self, first: Image, region: Image, rig: Rig) -> None:
        rows, columns = first.shape
        matrix = np.asarray(rig.topography_to_contact)
        mask = cv2.warpAffine(region, matrix, (columns, rows), flags=cv2.WARP_INVERSE_MAP + cv2.INTER_NEAREST)
        corners = cv2.goodFeaturesToTrack(first, rig.points, 0.01, 6.0, mask=mask, blockSize=5)
        self._first = first
        self.start: NDArray[np.float32] = np.asarray(corners, dtype=np.float32)[:, 0]
        self.last = self.start

    def follow(self, image: Image) -> Floats:
        """Return positions (N, 2) px; NaN for points that fail the forward-backward test."""
        at_start = np.concatenate((self.start, np.ones((len(self.start), 1))), axis=1, dtype=np.float64)
        affine = np.linalg.lstsq(at_start, self.last.astype(np.float64), rcond=None)[0].T
        warped = cv2.warpAffine(self._first, affine, image.shape[::-1], borderMode=cv2.BORDER_REFLECT)
        template = np.asarray(warped, dtype=np.uint8)
        start = (at_start @ affine.T).astype(np.float32)
        there, found = lucas_kanade(template, image, start, self.last, _WINDOW, levels=0)
        back, found_back = lucas_kanade(image, template, there, there - (self.last - start), _WINDOW, levels=0)
        tracked = (found & found_back & (np.linalg.norm(back - start, axis=1) <= 1))[:, None]
        self.last = np.where(tracked, there, self.last)
        return np.where(tracked, there, np.nan).astype(np.float64)


def _sample(mask: Image, points: NDArray[np.floating], rig: Rig) -> Image:
    """Return values of the contact view at points (N, 2) of the topography view; 0 outside."""
    matrix = np.asarray(rig.topography_to_contact)
    x, y = np.round(points @ matrix[:, :2].T + matrix[:, 2]).astype(int).T
    inside = (x >= 0) & (y >= 0) & (x < mask.shape[1]) & (y < mask.shape[0])
    return np.where(inside, mask[np.where(inside, y, 0), np.where(inside, x, 0)], 0).astype(np.uint8)


def _fields(
    position: Floats, covered: NDArray[np.bool_], outlines: Sequence[Outline], rig: Rig
) -> tuple[Floats, Floats, Floats]:
    """Compute divergence (F, N) of the displacement since the onset, its median (F,) and that of strain (F, 3)."""
    matrix = np.asarray(rig.topography_to_contact)
    glass = (position @ matrix[:, :2].T + matrix[:, 2]) * rig.mm_per_px
    onset = np.where(covered.any(0), covered.argmax(0), len(covered))
    numbers = np.flatnonzero(onset < len(covered))
    numbers = numbers[np.isfinite(glass[onset[numbers], numbers]).all(-1)]
    reference = glass[onset[numbers], numbers]
    near = cKDTree(reference).sparse_distance_matrix(cKDTree(reference), rig.gauge_mm / 2, output_type="coo_matrix")
    weights = np.eye(len(reference))
    weights[near.row, near.col] = (1 - (near.data / (rig.gauge_mm / 2)) ** 2) ** 2
    divergence, medians = np.full(position.shape[:2], np.nan), np.full((len(position), 4), np.nan)
    for frame, outline in enumerate(outlines):
        places = glass[frame, numbers]
        known = (onset[numbers] <= frame) & np.isfinite(places).all(-1)
        if known.sum() < _LEAST_POINTS or not np.isfinite(outline.center).all():
            continue
        places, start = places[known], reference[known]
        (xx, xy), (yx, yy) = _gradients(start, places - start, weights[np.ix_(known, known)])
        fields = np.stack(
            (xx + yy, xx + (xx**2 + yx**2) / 2, yy + (xy**2 + yy**2) / 2, (xy + yx + xx * xy + yx * yy) / 2)
        )
        divergence[frame, numbers[known]] = fields[0]
        determined = np.isfinite(fields).all(0)
        if determined.any():
            _, nearest = cKDTree(places[determined]).query(_grid_inside(outline, rig.mm_per_px))
            medians[frame] = np.median(fields[:, determined][:, nearest], axis=1)
    return divergence, medians[:, 0], medians[:, 1:]


def _gradients(points: Floats, values: Floats, weights: Floats) -> Floats:
    """Fit weighted planes around each point; return slopes (2, 2, N), a row per component of the values."""
    points = points - points.mean(0)
    x, y = points.T
    u, v = values.T
    columns = np.stack((np.ones_like(x), x, y, x * x, x * y, y * y, u, v, x * u, y * u, x * v, y * v), axis=1)
    total, *sums = (weights @ columns).T
    mean_x, mean_y, xx, xy, yy, mean_u, mean_v, xu, yu, xv, yv = np.array(sums) / total
    xx, xy, yy = xx - mean_x**2, xy - mean_x * mean_y, yy - mean_y**2
    along_x = np.stack((xu - mean_x * mean_u, xv - mean_x * mean_v))
    along_y = np.stack((yu - mean_y * mean_u, yv - mean_y * mean_v))
    enough = ((weights > 0).sum(1) >= _LEAST_POINTS) & (xx * yy - xy**2 > 1e-3 * (xx + yy) ** 2)
    determinant = np.where(enough, xx * yy - xy**2, np.nan)
    slopes = np.stack((yy * along_x - xy * along_y, xx * along_y - xy * along_x), axis=1)
    return np.asarray(slopes / determinant)


def _grid_inside(outline: Outline, mm_per_px: float) -> Floats:
    """Return positions (P, 2) mm on a square grid in the ellipse of the gross contact."""
    steps = np.ceil(outline.semi_axes[0] * mm_per_px / _GRID_MM) + 4
    offsets = np.arange(-steps, steps + 1) / steps
    right, down = np.meshgrid(offsets, offsets)
    unit = np.stack((right, down), axis=-1)[right**2 + down**2 <= 1]
    result: Floats = (outline.center + (unit * outline.semi_axes) @ outline.directions.T) * mm_per_px
    return result
