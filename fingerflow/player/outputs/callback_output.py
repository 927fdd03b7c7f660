"""Output to a function of the user's own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from fingerflow.player.named_objects import load_callable
from fingerflow.player.outputs.output import FrameStamp, Output

ADDRESS = "callback:MODULE:FUNCTION"

OnFrame = Callable[[FrameStamp, Mapping[str, float]], Any]


class CallbackOutput:
    """Output that calls a function with the stamp of a frame and its values."""

    def __init__(self, function: OnFrame) -> None:
        self._function = function

    def send(self, frame: FrameStamp, values: Mapping[str, float]) -> None:
        """Call the function."""
        self._function(frame, values)

    def close(self) -> None:
        """Do nothing, as the function is the user's."""


def open_address(address: str, units: Mapping[str, str]) -> Output:
    """Return the output to a function given as MODULE:FUNCTION."""
    return CallbackOutput(load_callable(address))
