"""Match discs between the two views, and fit the transform that registers the views."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fingerflow.calibration.edge import Array, Disc
from fingerflow.errors import FingerflowError

# Residual between two triangles after the best similarity transform, relative to their size. A compression of one axis
# to 0.8 gives 0.11, to 0.7 gives 0.18. The typical value scales the score; above the largest one the triangles do not
# match.
TYPICAL_DISTORTION, MOST_DISTORTION = 0.05, 0.2
# Error of the discs' radii: absolute natural logarithm of the ratio of the radii over the ratio of the triangles'
# sizes, with a typical and a largest value.
TYPICAL_SIZE_ERROR, MOST_SIZE_ERROR = 0.1, 0.3
# Smallest height of a triangle over its longest side: below it the transform across the line is undetermined.
LEAST_HEIGHT = 0.1
# Margin, as a share of the triangle's size, by which a mirror image must fit better to be reported: an isosceles
# triangle is its own mirror image.
MIRROR_MARGIN = 0.02
# Relative score above which a second labelling of the same discs makes the match ambiguous.
AMBIGUOUS = 0.5


@dataclass(frozen=True)
class Transform:
    """Transform between two views: an affine or similarity `matrix` (2, 3) from px (x, y, 1) to px (x, y).

    `residuals_px` (N, 2) are found minus transformed.
    """

    matrix: Array
    residuals_px: Array

    @property
    def rms_px(self) -> float:
        """Return the root mean square (RMS) length of the residuals of the transform, px."""
        return float(np.sqrt(np.mean(np.sum(self.residuals_px**2, axis=1))))


def match_discs(from_discs: list[Disc], to_discs: list[Disc]) -> list[tuple[Disc, Disc]]:
    """Match three discs of one view to three discs of another; return the pairs, largest disc first, then clockwise.

    The labels follow from the shape alone. Of all pairs of triangles, the pair is chosen that agrees best up to a
    similarity, in the positions and sizes of the discs, weighted by their significance. Raises FingerflowError if there
    are fewer than three discs, all lie on a line, one view is mirrored, no triangle agrees, or two labellings agree
    about equally well.
    """
    if min(len(from_discs), len(to_discs)) < 3:
        raise FingerflowError(
            f"the registration target needs 3 discs in each view; found in the topography view: {len(from_discs)} at "
            f"(x, y) px {_centres(from_discs)}; in the contact view: {len(to_discs)} at {_centres(to_discs)}. Check "
            f"the pixel ranges of the views, and that all discs are inside both, lit and in focus"
        )
    from_triples = _triangles(from_discs, combinations(range(len(from_discs)), 3))
    to_triples = _triangles(to_discs, permutations(range(len(to_discs)), 3))
    from_triple, to_triple = _best_pair(from_discs, from_triples, to_discs, to_triples)
    pairs = [(from_discs[first], to_discs[second]) for first, second in zip(from_triple, to_triple, strict=True)]
    offsets = np.array([second.center for _, second in pairs])
    offsets = offsets - offsets.mean(axis=0)
    largest = int(np.argmax([first.radius_px * second.radius_px for first, second in pairs]))
    # With the y axis pointing down, the angle from x towards y grows clockwise.
    angles = np.arctan2(offsets[:, 1], offsets[:, 0])
    return [pairs[index] for index in np.argsort((angles - angles[largest]) % (2 * np.pi))]


def fit_affine(from_points: ArrayLike, to_points: ArrayLike) -> Transform:
    """Fit an affine transform between two lists of points (N, 2) px, by least squares; exact for three points.

    Raises FingerflowError for fewer than three points, or points on a line.
    """
    source, target = _point_pairs(from_points, to_points, least=3)
    center = source.mean(axis=0)
    if np.linalg.matrix_rank(source - center, tol=1e-9 * (np.abs(source - center).max() + 1e-300)) < 2:
        raise FingerflowError(f"the points {source.tolist()} lie on a line; an affine transform needs a triangle")
    linear, *_ = np.linalg.lstsq(source - center, target - target.mean(axis=0), rcond=None)
    return _transform(linear.T, source, target)


def fit_similarity(from_points: ArrayLike, to_points: ArrayLike) -> Transform:
    """Fit a similarity (rotation, scale and shift, no reflection) between two lists of points (N, 2) px by least
    squares.

    With z and w the centred points as complex numbers it is w = s z, s = sum(conj(z) w) / sum(|z|^2).
    Raises FingerflowError for fewer than two points, or points that coincide.
    """
    source, target = _point_pairs(from_points, to_points, least=2)
    z, w = _centered_complex(source), _centered_complex(target)
    size = np.sum(np.abs(z) ** 2)
    if size == 0:
        raise FingerflowError(f"the points {source.tolist()} coincide; a similarity needs two that differ")
    factor = np.sum(np.conj(z) * w) / size
    linear = np.array([[factor.real, -factor.imag], [factor.imag, factor.real]])
    return _transform(linear, source, target)


def _point_pairs(from_points: ArrayLike, to_points: ArrayLike, least: int) -> tuple[Array, Array]:
    source, target = np.asarray(from_points, dtype=np.float64), np.asarray(to_points, dtype=np.float64)
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 2 or len(source) < least:
        raise FingerflowError(
            f"points of the shapes {source.shape} and {target.shape}; the same number of (x, y), at least {least}, "
            f"is needed in both views"
        )
    return source, target


def _transform(linear: Array, source: Array, target: Array) -> Transform:
    shift = target.mean(axis=0) - linear @ source.mean(axis=0)
    return Transform(np.column_stack([linear, shift]), target - (source @ linear.T + shift))


def _centered_complex(points: Array) -> NDArray[np.complex128]:
    """Return points (..., N, 2) as complex numbers x + iy (..., N), with the mean subtracted."""
    centered = points - points.mean(axis=-2, keepdims=True)
    return centered[..., 0] + 1j * centered[..., 1]


def _triangles(discs: list[Disc], triples: Iterable[tuple[int, ...]]) -> NDArray[np.int64]:
    """Return those triples (T, 3) of indices of discs that form triangles; raise FingerflowError if all triples are
    collinear.
    """
    indices = np.array(list(triples))
    corners = np.array([disc.center for disc in discs])[indices]
    sides = np.roll(corners, -1, axis=1) - corners
    double_area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    longest = np.sum(sides**2, axis=2).max(axis=1)
    tall = double_area >= LEAST_HEIGHT * longest
    if not tall.any():
        raise FingerflowError(
            f"discs at {_centres(discs)} px are collinear: no triangle of them is higher than {LEAST_HEIGHT} of its "
            f"longest side. Use a target with three discs that are not on a line"
        )
    return indices[tall]


def _best_pair(
    from_discs: list[Disc], from_triples: NDArray[np.int64], to_discs: list[Disc], to_triples: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    from_radii, from_weights = _log_radii_and_weights(from_discs)
    to_radii, to_weights = _log_radii_and_weights(to_discs)
    z = _centered_complex(np.array([disc.center for disc in from_discs])[from_triples])
    w = _centered_complex(np.array([disc.center for disc in to_discs])[to_triples])
    # All pairs of triangles at once. Of w = s z, sqrt(1 - |correlation|^2) is the residual as a share of the size of w;
    # the conjugate of z is its mirror image.
    from_size, to_size = np.linalg.norm(z, axis=1), np.linalg.norm(w, axis=1)

    def distortion(shape: NDArray[np.complex128]) -> Array:
        correlation = np.abs(shape @ w.T) / np.outer(from_size, to_size)
        return np.sqrt(np.clip(1 - correlation**2, 0, 1))

    proper, mirrored = distortion(np.conj(z)), distortion(z)
    scale = to_size / from_size[:, None]
    growth = to_radii[to_triples] - from_radii[from_triples][:, None]
    size_error = np.sqrt(np.mean((growth - np.log(scale)[..., None]) ** 2, axis=2))
    size_cost = np.where(size_error < MOST_SIZE_ERROR, (size_error / TYPICAL_SIZE_ERROR) ** 2, np.inf)
    weight = from_weights[from_triples].mean(axis=1)[:, None] + to_weights[to_triples].mean(axis=1)

    def score(residual: Array) -> Array:
        cost = np.where(residual < MOST_DISTORTION, (residual / TYPICAL_DISTORTION) ** 2, np.inf)
        return np.exp(weight - (cost + size_cost) / 2)

    proper_score, mirrored_score = score(proper), score(mirrored)
    first, second = np.unravel_index(np.argmax(proper_score), proper_score.shape)
    discs = f"one view has discs at {_centres(from_discs)}, the other at {_centres(to_discs)} px"
    mirror = np.unravel_index(np.argmax(mirrored_score), mirrored_score.shape)
    if (
        mirrored_score[mirror] > proper_score[first, second]
        and mirrored[mirror] < proper[first, second] - MIRROR_MARGIN
    ):
        from_points = [from_discs[index].center for index in from_triples[mirror[0]]]
        to_points = [to_discs[index].center for index in to_triples[mirror[1]]]
        raise FingerflowError(
            f"the target is mirrored from one view to the other ({discs}). Where one view is seen in a mirror, write "
            f"the transform into [calibration] of the scene yourself, topography_to_contact = "
            f"{fit_affine(from_points, to_points).matrix.tolist()}; where none is, check that both views show the same "
            f"side of the target"
        )
    if proper_score[first, second] == 0:
        raise FingerflowError(
            f"no three discs form the same triangle in both views ({discs}). Check the pixel ranges of the views, and "
            f"that the frame shows the registration target"
        )
    same_discs = (np.sort(to_triples, axis=1) == np.sort(to_triples[second])).all(axis=1)
    rivals = np.delete(proper_score[first] * same_discs, second)
    if rivals.size and rivals.max() > AMBIGUOUS * proper_score[first, second]:
        raise FingerflowError(
            f"the discs can be paired in more than one way ({discs}): the triangle looks the same when it is turned. "
            f"Use a target with sides or discs of different sizes"
        )
    return from_triples[first], to_triples[second]


def _log_radii_and_weights(discs: list[Disc]) -> tuple[Array, Array]:
    return np.log([disc.radius_px for disc in discs]), np.log([disc.significance for disc in discs])


def _centres(discs: list[Disc]) -> str:
    return ", ".join(f"({disc.center[0]:.0f}, {disc.center[1]:.0f})" for disc in discs)
