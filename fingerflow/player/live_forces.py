"""Forces of the frames of a stream: recorded with them, or measured by a live sensor."""

import bisect
import math
import threading
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError, first_line
from fingerflow.player.logged_warnings import log
from fingerflow.player.sensors.sensor import ForceSample, ForceSensor

_REMEMBERED = 4096  # largest number of samples kept
_CLOSE_BY = 0.05  # s, largest time between a frame and its sample; with more the force is NaN
_FAILED_WAIT = 0.2  # s to wait after a sample that could not be read


class LiveForces(NamedTuple):
    """Forces that were recorded with the frames of a stream: an array in N for each variable name, which begins at
    frame number ``first``.
    """

    first: int
    values: Mapping[str, Array]

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the force variables, such as `normal_force`."""
        return tuple(self.values)

    def read(self, number: int, time: float) -> Mapping[str, float]:
        """Return the forces recorded in frame `number`, N, by variable name; NaN for frames outside the recorded range.
        The time is not used.
        """
        index = number - self.first
        return {name: float(row[index]) if 0 <= index < len(row) else math.nan for name, row in self.values.items()}

    def close(self) -> None:
        """Do nothing, as no sensor is open."""


class SensorForces:
    """Forces measured by a live sensor, which is read by a thread of its own; a frame gets the sample nearest in time.

    Where the nearest sample is more than 0.05 s away, forces are NaN.
    """

    names = ("normal_force", "tangential_force")

    def __init__(self, sensor: ForceSensor, name: str) -> None:
        self._sensor, self._name = sensor, name
        self._samples: deque[ForceSample] = deque(maxlen=_REMEMBERED)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._read_all, name="forces", daemon=True)
        self._thread.start()

    def read(self, number: int, time: float) -> Mapping[str, float]:
        """Return the normal and tangential force in N, by variable name, of the sample nearest to a time in s on the
        axis of `time.perf_counter`; the frame number is not used.
        """
        samples = list(self._samples)
        index = bisect.bisect_left(samples, time, key=lambda sample: sample.time)
        near = min(samples[max(index - 1, 0) : index + 1], key=lambda sample: abs(sample.time - time), default=None)
        if near is None or abs(near.time - time) > _CLOSE_BY:
            return dict.fromkeys(self.names, math.nan)
        return {"normal_force": near.normal, "tangential_force": near.tangential}

    def close(self) -> None:
        """End the thread that reads the sensor and then closes it, waiting for it at most one second."""
        self._stop.set()
        self._thread.join(1.0)

    def _read_all(self) -> None:
        failed = False
        while not self._stop.is_set():
            try:
                sample = self._sensor.read()
            except BaseException as error:
                if not failed:
                    log.warning("%s: no force: %s", self._name, first_line(error))
                failed = True
                if isinstance(error, PlayerError) or not isinstance(error, Exception):
                    break
                self._stop.wait(_FAILED_WAIT)
                continue
            if sample is not None:
                failed = False
                self._samples.append(sample)
        try:
            self._sensor.close()
        except BaseException as error:
            log.warning("%s: closing: %s", self._name, first_line(error))


FrameForces = LiveForces | SensorForces  # where the forces of the frames of a stream come from
