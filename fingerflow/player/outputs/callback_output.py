"""Output of live values to a Python function of the user's own."""

from collections.abc import Callable, Mapping
from typing import Any

from fingerflow.player.named_objects import load_callable
from fingerflow.player.outputs.output import FrameStamp, Output

ADDRESS = "callback:MODULE:FUNCTION"

OnFrame = Callable[[FrameStamp, Mapping[str, float]], Any]


class CallbackOutput:
    """Output that calls a user's function for each frame, with the frame's stamp (number and times) and its live values
    by name.
    """

    def __init__(self, function: OnFrame) -> None:
        self.send = function

    def close(self) -> None:
        """Do nothing, as there is no connection to close."""


def open_address(address: str, units: Mapping[str, str]) -> Output:
    """Import the function that an address MODULE:FUNCTION names, and return an output that calls it; units are not
    used.
    """
    return CallbackOutput(load_callable(address))
