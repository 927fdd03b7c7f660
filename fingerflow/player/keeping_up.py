"""Decide whether the results of a stream keep up with its frames."""

import math
from collections import deque

_LATE = 0.1  # s, longest age of the newest result, and longest median latency, with which results keep up
_SHOWN = 1.0  # s for which a lag or a loss stays on the page, so that people see it


class KeepingUp:
    """Rule by which the live page says that results fall behind the camera.

    Results fall behind where the frame of the newest result is more than 0.1 s older than the newest frame, where the
    median latency of the last second is more than 0.1 s, or where frames or messages were lost. The few frames for
    which the tracker may wait before it decides do not count, so that a slow camera raises no alarm.

    Args:
        waiting: largest number of frames by which the newest result may trail the newest frame without being late.
    """

    def __init__(self, waiting: int) -> None:
        self._waiting = waiting
        # Times, s, and numbers of frames and messages lost until then.
        self._lost = deque([(-math.inf, 0, 0)])
        self._late, self._until = "", -math.inf

    def describe(self, now: float, age: float, trailing: int, lost: tuple[int, int], median: float | None) -> str:
        """Return in a few words how results fall behind, "" if they have kept up for the last second.

        Args:
            now: time in s; calls come in its order.
            age: s from the frame of the newest result to the newest frame.
            trailing: number of frames that came after the frame of the newest result.
            lost: numbers of frames and of messages lost since the stream began.
            median: latency of the last second in ms; None if there was no result.
        """
        late = max(age if trailing > self._waiting else 0.0, 1e-3 * (median or 0.0))
        if late > _LATE:
            self._late, self._until = f"{late:.1f} s behind", now + _SHOWN
        self._lost.append((now, *lost))
        while now - self._lost[1][0] >= _SHOWN:  # the first is the newest of those that are a second old
            self._lost.popleft()
        if now < self._until:
            return self._late
        for name, count, before in zip(("frame", "message"), lost, self._lost[0][1:], strict=True):
            if count > before:
                return f"{count - before} {name}{'s' * (count - before > 1)} lost within 1 s"
        return ""
