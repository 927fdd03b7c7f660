"""Clock of a camera on the time axis of this computer, from the time stamps and the arrivals of its frames."""

import logging
import math
import time

log = logging.getLogger("fingerflow.player")

#: Unix time, s, at `time.perf_counter()` 0. It is read once at the start, so that a step of the system clock shifts no
#: latency.
EPOCH = time.time() - time.perf_counter()
_WINDOW = 5.0  # s, window of the least offset; two quartz clocks drift apart by some 0.1 ms in it


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

    Attributes:
        has_stamps: whether the last frame had a time stamp of its camera.
    """

    def __init__(self) -> None:
        self.has_stamps = False
        self._warned = False
        self._last = self._began = math.nan
        self._start, self._first = math.nan, math.nan  # stamp and time of the first frame since the last restart
        # s, least offset between arrival and stamp in the present window, and in the window before.
        self._least = self._before = math.inf

    def update(self, stamp: float, arrival: float) -> tuple[float, float]:
        """Convert a frame's time stamp by the camera, s, and its arrival here, s, to two exposure times in s: one for
        intervals between frames, one for latencies.

        Both are on the axis of `arrival`. The first advances exactly as the stamps do, so that intervals are the
        camera's; the second follows the drift of both clocks. Without a stamp (NaN) both are the arrival.
        """
        self.has_stamps = math.isfinite(stamp)
        if not self.has_stamps:
            return arrival, arrival
        if not stamp > self._last:
            if not math.isnan(self._last) and not self._warned:
                self._warned = True
                log.warning("the camera's time stamp %.6f s is not after the one before, %.6f s", stamp, self._last)
            self._start, self._first, self._began = stamp, arrival, arrival
            self._least = self._before = math.inf
        self._last = stamp
        if arrival - self._began > _WINDOW:
            self._before, self._least, self._began = self._least, math.inf, arrival
        self._least = min(self._least, arrival - stamp)
        return self._first + stamp - self._start, stamp + min(self._least, self._before)
