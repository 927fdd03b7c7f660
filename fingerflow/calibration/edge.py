"""Sub-pixel measurement of a dark disc, by an ellipse fitted to the edge of the disc.

The image is unwrapped along the current ellipse: rows are angles, columns are radii. In the unwrapped image the edge is
a straight line, so smoothing along and across it does not shift it inwards. Smoothing the image itself would (by
sigma^2 / 2R for a circle of radius R). The steepest point of every ray is an edge point. An ellipse is fitted to
them by robust geometric least squares, and the next iteration unwraps along that ellipse.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, map_coordinates

Array = NDArray[np.float64]

# Half widths of the search band as fractions of the radius: wide while the ellipse is uncertain, then narrow.
SEARCH_BANDS = (0.45, 0.3, 0.2, 0.2)
# Edge points farther off than this many robust standard deviations get weight 0 (Tukey's biweight).
TUKEY_LIMIT = 4.685
# Least spread, px, that is assumed for the edge points: the detection itself places them up to 0.025 px off the best
# ellipse on noise-free drawings. With a smaller spread good points would be rejected and the coverage of a perfect disc
# would fall.
LEAST_EDGE_SPREAD_PX = 0.01
# The blur of a lens moves the steepest point of a curved edge inwards by blur^2 / 2R; this is not corrected.
_BLUR_SHIFT_PX = 0.02
# The errors of a ragged edge are correlated along the contour, so the number of its points does not give the error of
# the centre. In polar form harmonic 1 is a shift of the centre and harmonic 2 the ellipse. The next harmonics estimate
# the contribution of the raggedness to harmonic 1.
RAGGEDNESS_HARMONICS = range(3, 9)


@dataclass(frozen=True)
class Disc:
    """Dark disc measured in a view, in which the disc appears as an ellipse.

    Positions are (x, y) in px of the view; integers are pixel centres. `semi_axes_px` has the longer first, `angle`
    (rad, from x towards y, in [0, pi)) is its direction. `center_sigma_px` is the standard deviation of the centre
    along its worse direction. `edge_rms_px` is over the edge points that the robust fit kept, `coverage` their share of
    all directions. `contrast` is the step in brightness over the brightness outside. `significance` is that step over
    its spread along the contour, times the root of the radius in pixels.
    """

    center: tuple[float, float]
    semi_axes_px: tuple[float, float]
    angle: float
    center_sigma_px: float
    edge_rms_px: float
    coverage: float
    contrast: float
    significance: float

    @property
    def radius_px(self) -> float:
        """Return the radius, px, of a circle with the area of the disc."""
        return float(np.sqrt(self.semi_axes_px[0] * self.semi_axes_px[1]))

    @property
    def radius_sigma_px(self) -> float:
        """Return the standard deviation of the radius, px: from the scatter of the edge, whose mean has half the
        variance of a component of the centre, and from its blur.
        """
        return float(np.hypot(self.center_sigma_px / np.sqrt(2), _BLUR_SHIFT_PX))

    @property
    def axis_ratio(self) -> float:
        """Return the ratio of the shorter to the longer semi-axis of the disc."""
        return self.semi_axes_px[1] / self.semi_axes_px[0]


def fit_disc(image: Array, center: tuple[float, float], radius_px: float) -> Disc | None:
    """Fit an ellipse to the edge of a dark disc in an image (H, W), starting from an approximate circle.

    Returns None if there is no edge around it, or if the fit diverges from the guess.
    """
    middle, inverse = np.asarray(center, dtype=np.float64), np.eye(2) / radius_px
    for band in SEARCH_BANDS:
        unwrapped = _UnwrappedImage(image, middle, inverse, band)
        points, angles = unwrapped.edge_points()
        fitted = _fit_ellipse(points, middle, inverse)
        if fitted is None:
            return None
        middle, inverse, weights = fitted
        radius = 1 / np.sqrt(np.linalg.det(inverse))
        near = np.hypot(*(middle - center)) < 0.6 * radius_px and 0.5 < radius / radius_px < 2
        if not near or (middle < 0).any() or (middle > np.array(image.shape[::-1]) - 1).any():
            return None
    inliers = weights > 0
    distances, jacobian = _distances(points, middle, inverse)
    curvatures, directions = np.linalg.eigh(inverse)
    contrast, strength = unwrapped.step()
    return Disc(
        center=(float(middle[0]), float(middle[1])),
        semi_axes_px=(float(1 / curvatures[0]), float(1 / curvatures[1])),
        angle=float(np.arctan2(directions[1, 0], directions[0, 0]) % np.pi),
        center_sigma_px=_center_sigma(distances[inliers], jacobian[inliers], angles[inliers]),
        edge_rms_px=float(np.sqrt(np.mean(distances[inliers] ** 2))),
        coverage=float(inliers.sum() / len(unwrapped.angles)),
        contrast=contrast,
        significance=float(strength * np.sqrt(radius)),
    )


class _UnwrappedImage:
    """Grey levels (rays, radii) of an image, resampled along rays from the centre of an ellipse near the edge of a
    disc.

    `factors` are the radii as multiples of the ellipse's own, within `band` of 1.
    """

    def __init__(self, image: Array, middle: Array, inverse: Array, band: float) -> None:
        self.middle = middle
        self.shape = np.asarray(np.linalg.inv(inverse), dtype=np.float64)
        radius = float(np.sqrt(np.linalg.det(self.shape)))
        rays = int(np.clip(round(2 * np.pi * radius), 48, 720))
        self.angles = 2 * np.pi * np.arange(rays) / rays
        steps = 2 * max(6, round(2 * band * radius))  # half a pixel apart along each ray
        self.factors = np.linspace(1 - band, 1 + band, steps + 1)
        circle = np.stack([np.cos(self.angles), np.sin(self.angles)], axis=1) @ self.shape
        x = middle[0] + circle[:, :1] * self.factors
        y = middle[1] + circle[:, 1:] * self.factors
        height, width = image.shape
        self.inside_image = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
        # The cubic spline is fitted to this patch alone; boundary effects decay by 0.27 per pixel, negligible after
        # 12 px.
        left, top = max(0, int(x.min()) - 12), max(0, int(y.min()) - 12)
        patch = image[top : int(y.max()) + 13, left : int(x.max()) + 13]
        self.levels: Array = map_coordinates(patch, [y - top, x - left], order=3, mode="nearest")
        sigma_px = float(np.clip(0.06 * radius, 1.0, 3.0))
        self.sigma_rays = sigma_px * rays / (2 * np.pi * radius)
        self.sigma_factors = sigma_px / radius / float(self.factors[1] - self.factors[0])

    def edge_points(self) -> tuple[Array, Array]:
        """Return the position (N, 2), px, and angle (N,) of the steepest rise in brightness along each ray, the edge of
        the dark disc; rays without one are left out.
        """
        along = gaussian_filter1d(self.levels, self.sigma_rays, axis=0, mode="wrap")
        slope = gaussian_filter1d(along, self.sigma_factors, axis=1, order=1, mode="nearest")
        slope = np.where(self.inside_image, slope, -np.inf)
        peak = np.argmax(slope[:, 1:-1], axis=1) + 1
        ray = np.arange(len(peak))
        before, at, after = slope[ray, peak - 1], slope[ray, peak], slope[ray, peak + 1]
        # A maximum at the end of the band is rejected: it belongs to the edge of another object beyond it.
        good = np.isfinite(before) & np.isfinite(after) & (at > 0) & (at >= before) & (at > after)
        before, at, after, angle = before[good], at[good], after[good], self.angles[good]
        offset = (before - after) / (2 * (before - 2 * at + after))
        factor = self.factors[0] + (peak[good] + offset) * (self.factors[1] - self.factors[0])
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return self.middle + factor[:, None] * (circle @ self.shape), angle

    def step(self) -> tuple[float, float]:
        """Return the brightness step at the disc edge as a fraction of the brightness outside, and in standard
        deviations.

        The standard deviation is that of the step along the edge.
        """
        whole = self.inside_image.all(axis=1)
        if not whole.any():
            return 0.0, 0.0
        inside = self.levels[whole][:, self.factors < 0.9].mean(axis=1)
        outside = self.levels[whole][:, self.factors > 1.1].mean(axis=1)
        # A linear gradient of light across the disc is a cosine along the contour: it is excluded from the spread.
        angles = self.angles[whole]
        shading = np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles)], axis=1)
        coefficients = np.linalg.lstsq(shading, outside - inside, rcond=None)[0]
        spread = float(np.std(outside - inside - shading @ coefficients))
        step = float(coefficients[0])
        light = float(outside.mean())
        # A spread of 0.01 of the step is always added, so that a noise-free drawing is not infinitely significant.
        return step / light if light > 0 else 0.0, step / (np.hypot(spread, 0.01 * step) + 1e-300)


def _fit_ellipse(points: Array, middle: Array, inverse: Array) -> tuple[Array, Array, Array] | None:
    """Fit an ellipse to edge points (N, 2) px by robust least squares; return its centre, its inverse shape matrix,
    which maps it to the unit circle, and the weights of the points (N,).

    The fit starts from `middle` and `inverse`. None is returned if it fails.
    """
    if len(points) < 12:
        return None
    # A few iterations suffice: the next unwrapping of the edge starts from this result.
    for _ in range(6):
        distances, jacobian = _distances(points, middle, inverse)
        scale = max(1.4826 * float(np.median(np.abs(distances))), LEAST_EDGE_SPREAD_PX)
        weights = np.clip(1 - (distances / (TUKEY_LIMIT * scale)) ** 2, 0, None) ** 2
        root = np.sqrt(weights)
        change, _, rank, _ = np.linalg.lstsq(jacobian * root[:, None], -distances * root, rcond=None)
        if rank < 5:
            return None
        middle = middle + change[:2]
        inverse = inverse + np.array([[change[2], change[3]], [change[3], change[4]]])
        if np.linalg.eigvalsh(inverse)[0] <= 0:
            return None
        if np.hypot(*change[:2]) < 1e-4:
            break
    return middle, inverse, weights


def _distances(points: Array, middle: Array, inverse: Array) -> tuple[Array, Array]:
    """Return signed distances (N,) px of points from an ellipse (Sampson 1982), and the Jacobian (N, 5).

    The unknowns are the centre (x, y) and the symmetric inverse shape (xx, xy, yy), which, unlike axes and an angle, is
    regular at a circle.
    """
    offset = points - middle
    mapped = offset @ inverse
    length = np.linalg.norm(mapped, axis=1, keepdims=True)
    normal = mapped / length
    by_middle = -normal @ inverse
    steepness = np.linalg.norm(by_middle, axis=1, keepdims=True)
    by_inverse = np.stack(
        [
            normal[:, 0] * offset[:, 0],
            normal[:, 0] * offset[:, 1] + normal[:, 1] * offset[:, 0],
            normal[:, 1] * offset[:, 1],
        ],
        axis=1,
    )
    return ((length - 1) / steepness)[:, 0], np.concatenate([by_middle, by_inverse], axis=1) / steepness


def _center_sigma(distances: Array, jacobian: Array, angles: Array) -> float:
    """Return the standard deviation (px) of a fitted disc centre, from the signed distances (N,) of edge points to the
    ellipse, their derivatives by its five parameters, and their angles.
    """
    waves = np.stack([wave(k * angles) for k in RAGGEDNESS_HARMONICS for wave in (np.cos, np.sin)], axis=1)
    amplitudes = np.linalg.lstsq(waves, distances, rcond=None)[0]
    # White noise of variance v over N points gives every amplitude the variance 2 v / N.
    variance = len(distances) / 2 * float(np.mean(amplitudes**2))
    return float(np.sqrt(np.linalg.eigvalsh((variance * np.linalg.pinv(jacobian.T @ jacobian))[:2, :2])[-1]))
