"""Detect slip in a stream: the rim of the contact moves along the glass while its middle stays behind."""

import math

import numpy as np

from fingerflow.kernels.array_types import Array
from fingerflow.tracker.onset import interpolate_displacement

_FEWEST = 12  # least number of points in contact for a fit of five coefficients
_RAISED = 2.0  # factor on the noise of a point above which the flag is raised
_ALL_ROUND = 2.0  # factor on the spread: the whole rim is ahead, its last part by a third of its first part
_FRAMES = 3  # number of consecutive frames before the flag is raised or withdrawn


class SlipFlag:
    """Slip flag of a stream, raised when the rim of the contact has moved further along the glass than its middle.

    Displacement counts from the position of each point when its contact began. Under a tangential force the rim slips
    first, everywhere in the direction of the force: the displacement is an even function of the position in the
    contact. Skin that spreads under a growing normal force moves outward, which is an odd function. Skin that shifts
    as a whole while the contact grows has moved furthest in the middle, which touched first. In a rolling contact skin
    of the earlier press lies on one side, moved, and skin that has just touched on the other, which is half even and
    half odd. `rim_motion` separates them.

    The flag is raised where the rim is ahead of the middle, in the direction of the mean displacement, by more than
    twice the noise of a point and by more than twice the spread of the skin: the whole rim is then ahead. It stays
    while this lead, or the residual of a rigid motion, exceeds twice the noise. It appears two frames after the first
    frame that shows slip, plus the latency of a frame. On trials of `fingerflow.synthetic.PartialSlip` it is raised
    when 5 to 11 % of the contact have slipped, and in presses and rolls in no frame (`python -m tests.silent
    slip_flag`).

    Torsion about the centre of the contact is odd and does not raise the flag. A shift of the whole contact during a
    press hides as much slip as it has moved the middle ahead of the rim. At a reseeding each new point takes over the
    displacement of the nearest old points. If too few of these are known, the flag is not withdrawn before the contact
    ends.

    Attributes:
        slipping: the flag after the last frame; it changes after three frames in a row that say so.
    """

    def __init__(self) -> None:
        self._touched: Array = np.empty((0, 2))
        self._run = 0
        self._held = False  # True if the points that showed slip are lost: the flag then stays until the contact ends
        self.slipping = False

    def follow_others(self, before: Array, points: Array) -> None:
        """Give newly seeded points (N, 2) px displacements since contact onset, interpolated from those of the nearest
        previous points.

        In the frame of the seeding the previous points lay at `before` (M, 2) px, NaN where lost.
        """
        moved = before - self._touched if len(self._touched) else np.full_like(before, np.nan)
        inherited, _ = interpolate_displacement(before, moved, points, _FEWEST)
        self._touched = points - inherited
        self._held |= self.slipping and not np.isfinite(inherited).any()

    def update(self, points: Array, std: Array, covered: Array) -> float:
        """Add the next frame, and return its slip residual, px: the RMS deviation per component of the displacement in
        the contact from a rigid motion; NaN where fewer than 12 points are in contact.

        Args:
            points: (N, 2) px, NaN where lost.
            std: (N,) px, standard deviation of a component.
            covered: (N,) whether the apparent (gross) contact covers each.
        """
        if not len(self._touched):
            self._touched = np.full(points.shape, np.nan)
        # Use complex numbers, since NumPy takes several times as long over an axis of two.
        position = np.ascontiguousarray(points, np.float64).view(np.complex128)[:, 0]
        touched = self._touched.view(np.complex128)[:, 0]
        finite = np.isfinite(position)
        covered = covered.astype(bool, copy=False)
        begins = covered & finite & np.isnan(touched)
        if np.logical_or.reduce(begins):
            touched[begins] = position[begins]
        touched[~covered] = np.nan
        used = (finite & np.isfinite(touched) & np.isfinite(std)).nonzero()[0]
        residual, ahead, spread, noise = [math.nan] * 4
        if len(used) >= _FEWEST:
            residual = rigid_residual_rms(touched[used], position[used])
            ahead, spread = rim_motion(touched[used], position[used])
            deviations = std[used].astype(np.float64)
            noise = _RAISED * math.sqrt(float(deviations @ deviations) / len(deviations))
        touching = bool(np.logical_or.reduce(covered))
        self._held &= touching
        # Too few points in contact neither raise nor withdraw the flag: comparisons with NaN are False.
        unknown = self._held or (math.isnan(residual) and touching)
        stays = unknown or max(ahead, residual) > noise
        above = stays if self.slipping else ahead > max(noise, _ALL_ROUND * spread)
        self._run = self._run + 1 if above != self.slipping else 0
        if self._run >= _FRAMES:
            self.slipping, self._run = above, 0
        return residual


def rim_motion(before: Array, after: Array) -> tuple[float, float]:
    """Return, in px, how far the rim of the contact has moved ahead of its middle along the mean displacement, and how
    far it has moved outward or sheared, from positions (N,) before and after.

    The displacement is fitted by u = c + a z + b z* + e |z|^2 + d |z|^2 z, with z the position about the mean of the
    points, 1 at the rim of a uniformly covered disc. The first result is the component of e along the mean
    displacement, positive where the rim is ahead; the second is the odd part at the rim, sqrt(|a + d|^2 + |b|^2).

    Points (N,) are x + i y.
    """
    count, moved = len(before), after - before
    z = before - np.add.reduce(before) / count
    square = z.real**2 + z.imag**2
    scale = 2 * float(np.add.reduce(square)) / count
    z, square = z / math.sqrt(scale), square / scale
    basis = np.empty((6, count), complex)
    basis[0], basis[1], basis[2], basis[3], basis[4], basis[5] = 1, z, z.conj(), square, square * z, moved
    equations = basis[:5].conj() @ basis.T
    # Regularisation, as points on one line do not determine all coefficients.
    equations.ravel()[::7] += 1e-9 * count
    for row in range(5):  # the matrix is positive definite; `np.linalg.solve` takes a dozen calls of Python
        pivot = equations[row] / equations[row, row]
        equations -= equations[:, row, None] * pivot
        equations[row] = pivot
    _, a, b, e, d = equations[:, 5].tolist()
    mean = complex(np.add.reduce(moved)) / count
    return (e * mean.conjugate()).real / abs(mean) if mean else 0.0, math.hypot(abs(a + d), abs(b))


def rigid_residual_rms(before: Array, after: Array) -> float:
    """Return the RMS residual per component after the best rigid motion of `before` onto `after` (Procrustes).

    Points (N,) are x + i y.
    """
    start, end = before - np.add.reduce(before) / len(before), after - np.add.reduce(after) / len(after)
    product = start.conj() @ end
    off = end - start * (product / abs(product) if product else 1)
    return math.sqrt(float((off.conj() @ off).real) / (2 * len(off)))
