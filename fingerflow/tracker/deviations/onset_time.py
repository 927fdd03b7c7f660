"""Covariance of displacements by the uncertain time of the onset of contact."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fingerflow.engines.engine import Engine
from fingerflow.kernels.array_types import Array
from fingerflow.kernels.result_records import FrameEllipse
from fingerflow.tracker.contact_border import BORDER_MM

#: mm, standard deviation of the fitted ellipse of the border; measured on presses at 40 to 300 frames/s.
ELLIPSE_MM = 0.035
_ALIKE = np.eye(2, dtype=np.float32)  # shape of errors that are the same in all directions
_LEAST = 1e-10  # mm^2/frame^2, of points whose speed is lost in noise: they, too, count from their onsets
_LONGEST = 8  # largest number of frames on either side over which the speed at onset is measured


def onset_errors(
    engine: Engine, onset: Array, reference: Array, advected: Array, frames: tuple[int, int],
    positions: Callable[[Array], tuple[Array, Array]], border: FrameEllipse, faint_mm: float = 0.0,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return the variance (N,) frame^2 of the times at which points came into contact, the covariance (N, 2, 2) mm^2 of
    their positions then by this error, from the speed of each point at its onset, and the share (N,) of both that is
    known to be independent of the errors of neighbours.

    The coverage of a point selects the two frames of its onset, with an error of `BORDER_MM`, which the border takes d
    frames to cross. The ellipse gives the time between these frames. The error is 0 where the ellipse is crossed
    between the selected frames, and otherwise their distance from that crossing; its mean square is d^3 / (d + 1.4)
    frame^2 to a tenth. The error of the ellipse itself (`ELLIPSE_MM`) adds to it, less with larger d. Errors of
    neighbours are taken as independent, as the border crosses one ridge after the other. A point that touches in the
    first frame has no onset: its displacement counts from there.

    Where a border grows, neighbours tell how fast it passes the skin. Where it stops, the point's own depth in the
    ellipse tells how much slower it was passed on one side of its onset: a point that the border reached last may have
    been carried over it later. Skin that was advected crosses a border at rest, where neighbours enter along one line:
    there its own depth over the frames on both sides does.

    Args:
        engine: fits how fast the border passes the skin.
        onset: (N,) frame, -1 for none.
        reference: (N, 2) mm, position at the onset; NaN for none.
        advected: (N,) bool, points that the motion of the skin carried over the border.
        frames: first frame, whose points in contact have no onset, and last frame that is known.
        positions: returns the positions (3, N, 2) mm of the points, each in the frames (3, N) given for it, and the
            standard deviations (3, N) mm of a component by image noise.
        border: of the apparent contact, of all frames from 0.
        faint_mm: by which the border may lie further out, as the rim of the contact is faint: onsets are that late.
    """
    first, last = frames
    counts = onset > first
    frames_per_mm = np.zeros(len(onset))
    fitted = (counts & np.isfinite(reference[:, 0] + reference[:, 1])).nonzero()[0]
    if not len(fitted):
        return frames_per_mm, np.zeros((len(onset), 2, 2)), frames_per_mm
    # The graph of a bundle fits two quantities.
    times = np.stack((onset[fitted], np.zeros(len(fitted))), axis=-1)[None]
    touched, gauge = reference[fitted], engine.settings.gauge_length_mm
    slope = engine.fit(touched, times, touched, gauge)[0][0, :, 0]
    frames_per_mm[fitted] = np.where(advected[fitted], 0.0, np.nan_to_num(np.hypot(slope[:, 0], slope[:, 1])))
    reach = np.minimum(np.maximum(np.sqrt(_crossing_variance(frames_per_mm)).round(), 2), _LONGEST).astype(int)
    reach[advected] = _LONGEST
    around = np.minimum(np.maximum((onset - reach, onset, onset + reach), 0), last)
    position, deviation = positions(around)
    unknown = ~np.isfinite(position[..., 0] + position[..., 1])
    if np.logical_or.reduce(unknown, None):
        around = np.where(unknown, np.maximum(onset, 0), around)
        position, deviation = positions(around)
    steps = around[1:] - around[:-1]
    both = np.maximum(steps.sum(0), 1)
    speed = np.nan_to_num((position[2] - position[0]) / both[:, None])
    # The square of a measured speed is too large by the variance of the speed, which follows from those of both
    # positions.
    noise = (deviation[::2] ** 2).sum(0) / 2 / both**2
    share = np.minimum(np.maximum(1 - 2 * noise / np.maximum((speed**2).sum(1), 1e-30), 0), 1)
    speed = np.where(np.isfinite(share), np.sqrt(share), 0.0)[:, None] * speed
    depth = border.select(around.flatten()).inside(position.reshape(-1, 1, 2)).reshape(around.shape)
    # Within half a chord of sagitta b, sqrt(2 r b), skin that moves along the border is in or out.
    least = np.linalg.norm(speed, axis=1) * np.sqrt(BORDER_MM / 2 / np.nanmean(border.semi_axes))
    along = np.maximum(np.fmax((depth[2] - depth[0]) / both, least), 1e-9)
    # Not more than a deviation of the difference of two depths slower than measured.
    sides = depth[1:] - depth[:-1] + np.sqrt(2) * ELLIPSE_MM
    slower = np.fmin(*np.where(steps > 0, sides / np.maximum(steps, 1), np.inf))
    slowest = np.fmax(frames_per_mm, 1 / np.where(advected, along, np.maximum(slower, BORDER_MM / reach)))
    variance = np.where(counts, _crossing_variance(slowest) + (faint_mm * slowest) ** 2, 0.0)
    share = np.minimum(_crossing_variance(frames_per_mm) / np.maximum(variance, 1e-30), 1)
    of_speed = speed[:, :, None] * speed[:, None, :] + _LEAST * _ALIKE
    return variance, variance[:, None, None] * of_speed, share


def displacement_covariance(variance: Array, of_onset: Array, shape: Array = _ALIKE) -> NDArray[np.float32]:
    """Return the covariance (n, N, 2, 2) of displacements: their `variance` (n, N), the mean over directions, times the
    `shape` (N, 2, 2) of its ellipse, and the covariance `of_onset` (N, 2, 2) or (n, N, 2, 2) by the error of the time
    of onset.
    """
    result: NDArray[np.float32] = variance[..., None, None] * shape
    result += of_onset.astype(np.float32)
    return result


def _crossing_variance(frames_per_mm: Array) -> Array:
    """Return the variance (N,) frame^2 of the times at which the border passed N points, from the frames that it needs
    for a millimetre.
    """
    rough = BORDER_MM * frames_per_mm
    return (ELLIPSE_MM * frames_per_mm) ** 2 / (1 + rough) + rough**3 / (rough + 1.4)
