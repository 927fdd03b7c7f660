"""Force sensor that is a function of the user's own."""

import time
from collections.abc import Callable
from typing import Any

from fingerflow.player.named_objects import load_callable
from fingerflow.player.sensors.sensor import ForceSample, ForceSensor, parse_sample

ADDRESS = "callback:MODULE:FACTORY"
_NONE_NOW = 0.001  # s to wait if the function has no sample


class CallbackSensor:
    """Force sensor that a user's function reads: it waits for a sample and returns its forces in N, or None if there is
    none.

    A number is the normal force, a tuple normal force and up to two tangential components. The time of a sample is that
    of the function's return. Its `close` is called if it has one.
    """

    def __init__(self, grab: Callable[[], Any]) -> None:
        self._grab, self.close = grab, getattr(grab, "close", lambda: None)

    def read(self) -> ForceSample | None:
        """Call the user's function, and return its forces as a sample with the time of its return; None if it returns
        None.
        """
        forces = self._grab()
        if forces is None:
            time.sleep(_NONE_NOW)
            return None
        values = forces if isinstance(forces, (tuple, list)) else [forces]
        return parse_sample(time.perf_counter(), [float(force) for force in values])


def open_address(address: str) -> ForceSensor:
    """Return the force sensor of an address MODULE:FACTORY; the factory is called and returns the function that reads
    the sensor.
    """
    return CallbackSensor(load_callable(address)())
