"""Vibration of the whole image, as of a camera or its mount, found by the motion that all points have in common: shift,
rotation and change of scale.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.arrays import nanmedian

Values = Any  # array with frames along the first axis, in memory or in a file
Complex = NDArray[np.complex128]  # of x + i y

#: Number of frames of a result that are read at a time.
FRAMES_READ = 64
_WINDOW = 12  # frames, the period of which a smooth path has half
_LEAST_FRAMES = 2 * _WINDOW
_COMPARED = 150  # least number of points of which steps are taken, if there are as many; at most twice as many
_FEWEST = 12  # least number of points in contact, and of points beside it, of whose steps the medians are compared
# Least root mean square of a component, in px, in each quarter of the frames, least covariance of skin in contact and
# beside it over the larger variance, and least share of the largest quarter in every quarter: a jerk of the finger has
# less.
_LEAST_PX, _ALIKE, _STEADY = 0.02, 0.5, 0.25
_FROM_XY = np.array((1, 1j))


def vibration(
    position: Values, in_contact: Values, frames: NDArray[np.intp], mm_per_px: float, counted: str
) -> tuple[Complex, list[str]]:
    """Return shift (mm) and turn (F, 2) of the image by vibration, and a warning if there is one: positions z = x + i y
    are off by shift + turn z, where turn is the change of scale + i rotation (rad).

    Shift, rotation and change of scale are each what a smooth path leaves of that of the points, if skin in contact and
    skin beside it have it in common: glass holds the skin in contact, so that a finger that trembles moves the skin
    beside it alone. Next to frames that do not count it is off by up to half. Slower motion of a camera is not told
    from that of a finger.

    Args:
        position: (F, N, 2) mm, NaN for points not tracked.
        in_contact: (F, N) bool.
        frames: numbers of the usable frames.
        counted: says what contains the vibration.
    """
    result = np.zeros((position.shape[0], 4))
    some = slice(None, None, max(1, position.shape[1] // _COMPARED))
    start = position[frames[:1]][:, some]
    centre = nanmedian(start) @ _FROM_XY
    radius = float(np.fmax(nanmedian(abs(start @ _FROM_XY - centre))[0], mm_per_px))

    def steps(side: bool | None) -> NDArray[np.float64]:
        """Return the steps (F, 4) of the points in contact (True), of those beside it (False) or of all (None)."""
        taken, before = np.full((len(frames), 4), np.nan), np.full(start.shape[:2], np.nan)
        for rows in np.array_split(np.arange(len(frames)), len(frames) // FRAMES_READ + 1):
            read = slice(int(frames[rows[0]]), int(frames[rows[-1]]) + 1)
            here, inside = (values[read][frames[rows] - read.start][:, some] for values in (position, in_contact))
            here = here @ _FROM_XY - centre
            moved, before = np.diff(here, axis=0, prepend=before), here[-1:]
            group = np.isfinite(moved) if side is None else np.isfinite(moved) & (inside == side)
            taken[rows] = np.where(group.sum(1)[:, None] >= _FEWEST, _step(here, moved, group, radius), np.nan)
        return taken

    common, least = np.nan_to_num(steps(None)), np.full(4, (_LEAST_PX * mm_per_px) ** 2)
    # Skin in contact and beside it is compared only where the whole moves.
    if len(frames) > _LEAST_FRAMES and (np.square(_fast(common)).mean(0) > least).any():
        contact, beside = steps(True), steps(False)
        both = np.logical_and.reduce(np.isfinite(contact + beside), 1)
        if both.sum() > _LEAST_FRAMES:
            # Of the steps, as the path has a jump where a group begins.
            ours, theirs = (_fast(np.where(both[:, None], each, common))[both] for each in (contact, beside))
            # Of independent errors of both, the product has none on average.
            quarters = np.stack([quarter.mean(0) for quarter in np.array_split(ours * theirs, 4)])
            least = np.fmax(least, _STEADY**2 * quarters.max(0))
            alike = (ours * theirs).mean(0) > _ALIKE * np.fmax(np.square(ours).mean(0), np.square(theirs).mean(0))
            # Where one component vibrates, less of another is vibration, too.
            found = alike & (alike & (quarters.min(0) > least)).any()
            result[frames] = _fast(common.cumsum(0)) * found
    motion, rms = result.view(np.complex128) / (1, radius), np.sqrt(np.square(result).mean(0))
    motion[:, 0] -= motion[:, 1] * np.nan_to_num(centre)
    warning = (
        f"the whole image vibrates, by {np.hypot(*rms[:2]) / mm_per_px:.2g} px, {np.degrees(rms[3] / radius):.2g} "
        f"degrees and {rms[2] / radius:.2%} of its size RMS: {counted}. Of slower motion, over {_WINDOW} frames a "
        f"period, most remains in all. Check what shakes the camera: a fan, a motor, a loose mount"
    )
    return motion, [warning] * bool(rms.any())


def steady(position: NDArray[np.float64], motion: Complex) -> NDArray[np.float64]:
    """Return positions (..., 2) mm without the motion (..., 2) of the image by vibration."""
    off = motion[..., 0] + motion[..., 1] * (position @ _FROM_XY)
    return position - np.stack((off.real, off.imag), axis=-1)


class SteadyPositions:
    """Positions (F, N, 2) mm of the points without the vibration `motion` (F, 2) of the image, as `vibration` returns
    it, which is subtracted when frames are read.
    """

    def __init__(self, position: Values, motion: Any) -> None:
        self._position, self._motion, self.shape = position, motion, position.shape

    def __getitem__(self, frames: Any) -> NDArray[np.float64]:
        return steady(self._position[frames], self._motion[frames, None])


def _step(here: Complex, moved: Complex, group: NDArray[np.bool_], radius: float) -> NDArray[np.float64]:
    """Return shift, change of scale and rotation (n, 4), mm at a `radius`: medians over the motions `moved` (n, N) of
    the points of a `group` (n, N) at `here` (n, N).
    """

    def median(values: Complex) -> Complex:
        parts = np.stack((values.real, values.imag), axis=-1)
        return (nanmedian(np.where(group[..., None], parts, np.nan)) @ _FROM_XY)[:, None]

    with np.errstate(divide="ignore", invalid="ignore"):  # of a point in the middle
        turn = median((moved - median(moved)) / (here - median(here)))
    return np.concatenate((median(moved - turn * here), radius * turn), axis=1).view(np.float64)


def _fast(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what is left of series (F, ...) beside smooth ones, which have half of a period of `_WINDOW` frames and
    less of a shorter one, by the sixth power of the frequency.
    """
    columns = values.reshape(len(values), -1)
    # Both ends go on by linear prediction, as a smooth series could follow a vibration up to its end.
    columns = _predicted(_predicted(columns)[::-1])[::-1]
    columns = columns - np.linspace(columns[0], columns[-1], len(columns))
    power = np.fft.rfftfreq(len(columns)) ** 6
    spectrum = np.fft.rfft(columns, axis=0) * (power / (power + _WINDOW**-6.0))[:, None]
    return np.fft.irfft(spectrum, len(columns), axis=0)[_WINDOW:-_WINDOW].reshape(values.shape)


def _predicted(columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return series (F, C) with `_WINDOW` values more, each predicted from as many before it."""
    parts = np.lib.stride_tricks.sliding_window_view(columns, _WINDOW + 1, axis=0)
    result = np.concatenate((columns, np.zeros((_WINDOW, columns.shape[1]))))
    for k, part in enumerate(parts.swapaxes(0, 1)):
        # Backwards, too, for which the same weights hold: those of one direction alone may let the series grow.
        known = np.concatenate((part, part[:, ::-1]))
        weights = np.linalg.lstsq(known[:, :-1], known[:, -1], rcond=1e-6)[0]
        for frame in range(len(columns), len(result)):
            result[frame, k] = result[frame - _WINDOW : frame, k] @ weights
    return result
