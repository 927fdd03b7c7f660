"""Define the interface of live force sensors."""

import math
from typing import NamedTuple, Protocol

from fingerflow.errors import PlayerError


class ForceSample(NamedTuple):
    """Sample of a force sensor: time, normal force and tangential force.

    Attributes:
        time: s, on the axis of `time.perf_counter`.
        normal, tangential: N; tangential is NaN where the sensor measures none.
    """

    time: float
    normal: float
    tangential: float


class ForceSensor(Protocol):
    """Interface of a live force sensor. It is read by a thread of its own."""

    def read(self) -> ForceSample | None:
        """Return the next sample after waiting for it; None if none came for a while.

        Any other exception than PlayerError counts as a sample that could not be read.
        """

    def close(self) -> None:
        """Close the connection to the sensor."""


def parse_sample(time: float, forces: tuple[float, ...] | list[float]) -> ForceSample:
    """Return the sample at a time, s, of one to three forces in N: normal; normal and tangential, which keeps its sign;
    or normal and two tangential components, of which the magnitude is taken.

    Raises PlayerError for another number of forces.
    """
    if not 1 <= len(forces) <= 3:
        raise PlayerError(
            f"the force sensor gives {len(forces)} numbers; it must give the normal force and up to two tangential ones"
        )
    normal, *tangential = forces
    if len(tangential) == 2:
        tangential = [math.hypot(*tangential)]
    return ForceSample(time, normal, *tangential or [math.nan])
