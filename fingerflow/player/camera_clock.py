"""Clock of a camera on the time axis of this computer, from the time stamps and the arrivals of its frames."""

import math
import time

from fingerflow.player.logged_warnings import log

#: Unix time, s, at `time.perf_counter()` 0. It is read once at the start, so that a step of the system clock shifts no
#: latency.
EPOCH = time.time() - time.perf_counter()
_MOST_AHEAD = 0.25  # s by which a stamp may advance more than arrivals do: frames that waited arrive together
_MOST_JUMPS = 3  # frames in a row in which stamps run ahead before their unit is found
_LEAST_PASSED = 0.1  # s, the same
_NEAR = 0.05  # s from the arrivals, within which stamps behind unusable ones go on as before
_UNITS = (1e-3, 1e-6, 1e-9, 60.0, 3600.0, 86400.0)  # s: what stamps count besides seconds
_LEAST = 1e-9  # s between two frames that arrive at once
_WINDOW = 5.0  # s, window of the least offset; two quartz clocks drift apart by some 0.1 ms in it
_LATE = 0.97  # share of the window by which stamps fall behind arrivals where they are in a larger unit than s
_OFF = 0.05  # the same in two windows in a row where stamps are of another rate


def unix_now() -> float:
    """Return the Unix time in s, advanced since the start by `time.perf_counter`, so that no step of the system clock
    shifts it.
    """
    return EPOCH + time.perf_counter()


class CameraClock:
    """Converter of a camera's time stamps to the clock `time.perf_counter` of this computer.

    A frame cannot arrive before its stamp: the smallest difference between arrival and stamp of the last 5 to 10 s is
    the offset of both clocks plus the shortest transfer. What a frame takes longer counts as latency; the shortest
    transfer itself cannot be told from the offset and does not.

    Stamps are compared with arrivals: between two frames they cannot advance by much more than arrivals do. Where they
    do so from frame to frame, they count ms, us or ns and are converted, or are refused; as are those that hardly
    advance within 5 s, which may count minutes, hours or days, and those whose rate differs by over 5 % from that of
    arrivals in two windows of 5 s in a row. Where they run ahead once, or where a stamp is missing or not after the one
    before, time advances by arrivals over that interval, and the next stamps count as before where they agree with it:
    stamps that repeat do not add up. So it never runs backwards.

    Attributes:
        has_stamps: whether the last frame had a usable time stamp of its camera.
    """

    def __init__(self) -> None:
        self.has_stamps = self._warned = False
        self._unit = 1.0  # s, unit of the stamps; NaN if they are refused
        # Stamp, time and arrival of the last frame; stamp and arrival of the frame before stamps began to run ahead.
        self._last = self._time = self._arrival = math.nan
        self._ahead: tuple[float, float] | None = None
        # Stamp at time 0, s, and whether the last stamp was unusable.
        self._jumps, self._began, self._zero, self._skips = 0, math.nan, math.nan, False
        # s, least offset between arrival and stamp in the present window, and in the window before.
        self._least = self._before = math.inf
        # s, offset at the begin of the present window; share of the window before by which stamps fell behind.
        self._offset, self._behind = math.nan, 0.0

    def update(self, stamp: float, arrival: float) -> tuple[float, float]:
        """Convert a frame's time stamp by the camera and its arrival here, s, to two exposure times in s: one for
        intervals between frames, one for latencies.

        Both are on the axis of `arrival`. The first advances exactly as the stamps do, so that intervals are the
        camera's; the second follows the drift of both clocks. Without a stamp (NaN) both advance as arrivals do.
        """
        stamp *= self._unit
        self.has_stamps = math.isfinite(stamp)
        step, passed = stamp - self._last, arrival - self._arrival
        usable = step > 0 and step - passed <= _MOST_AHEAD
        if self.has_stamps and not usable and not math.isnan(self._last):
            self._compare(stamp, arrival)
        elif usable:
            self._ahead = None
        by_arrival = arrival if math.isnan(self._arrival) else self._time + max(passed, _LEAST)
        if usable and self._skips and not abs(stamp - self._zero - by_arrival) < _NEAR:
            self._zero = stamp - self._time - step
        elif math.isnan(self._zero):
            self._zero = stamp - by_arrival
        self._time = max(stamp - self._zero, self._time + _LEAST) if usable else by_arrival
        self._last, self._arrival, self._skips = stamp, arrival, not usable
        if not usable:
            self._least = self._offset = arrival - stamp
            self._before, self._began, self._behind = math.inf, arrival, 0.0
            return self._time, arrival
        if (window := arrival - self._began) > _WINDOW:
            late = arrival - stamp - self._offset
            behind = late / window if abs(late) > _OFF * window else 0.0
            if late > _LATE * (window - passed) + passed or behind * self._behind > 0:
                self._time = max(self._time, arrival)
                self._find_unit(window - late, window)
            self._before, self._least, self._began = self._least, math.inf, arrival
            self._offset, self._behind = arrival - stamp, behind
        self._least = min(self._least, arrival - stamp)
        return self._time, stamp + min(self._least, self._before)

    def _compare(self, stamp: float, arrival: float) -> None:
        """Compare a stamp that is not after the one before, or runs ahead of the arrivals, with them; find the unit of
        stamps that do so in several frames in a row.
        """
        if not self._warned:
            self._warned = True
            log.warning(
                "the camera's time stamp %.6f s does not follow the one before, %.6f s, as arrivals do, between which "
                "%.6f s passed: times there are those of arrivals", stamp, self._last, arrival - self._arrival,
            )  # fmt: skip
        if stamp < self._last:
            self._ahead = None
            return
        if self._ahead is None:
            self._ahead, self._jumps = (self._last, self._arrival), 0
        self._jumps += 1
        passed = arrival - self._ahead[1]
        if self._jumps >= _MOST_JUMPS and passed >= _LEAST_PASSED:
            self._find_unit(stamp - self._ahead[0], passed)

    def _find_unit(self, advanced: float, passed: float) -> None:
        """Find the unit of stamps that advance by `advanced` while `passed` s pass, or refuse them."""
        units = [unit for unit in _UNITS if 0.8 < advanced * unit / passed < 1.25]
        self._unit = units[0] if units else math.nan
        log.warning(
            "the camera's time stamps advance by %.4g s while %.4g s pass: %s", advanced, passed,
            f"they are taken to count units of {units[0]:g} s; return s" if units
            else "they are not used, and times are those of arrivals; return the time of each frame in s",
        )  # fmt: skip
