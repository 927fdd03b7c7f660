"""Define the interface of outputs, and the stamp of a frame that every message carries."""

import json
import math
from collections.abc import Mapping
from typing import NamedTuple, Protocol

from fingerflow.engines.engine import Array


class FrameStamp(NamedTuple):
    """Stamp of a message with live values: number, camera time and record of the frame they belong to, and time of
    writing.

    Attributes:
        number: of the frame, as in the records; gaps are frames that were dropped or overtaken.
        camera_time: Unix time in s at which the camera took the frame, by its own stamps where it gives them, else
            the time of arrival.
        written: Unix time in s at which the message is written.
        record: the record of the frame, by the names of `read_results`, with positions and fields of all points.
    """

    number: int
    camera_time: float
    written: float
    record: Array


#: Stamp of a frame, and its live values by name.
LiveFrame = tuple[FrameStamp, Mapping[str, float]]


class Output(Protocol):
    """Interface of an output, which sends the live values of frames to a receiver; a thread of its own calls it."""

    def send(self, frame: FrameStamp, values: Mapping[str, float]) -> None:
        """Send the live values of a frame, given by variable name in the units of the data set, NaN where unknown.

        Any exception counts as a message that failed.
        """

    def close(self) -> None:
        """Close the connection to the receiver."""


def as_json(frame: FrameStamp, values: Mapping[str, float]) -> bytes:
    """Encode number and times of a frame and its live values by name as one JSON object, with null for unknown ones."""
    stamp = {"frame": frame.number, "camera_time": frame.camera_time, "written": frame.written}
    numbers = {name: value if math.isfinite(value) else None for name, value in values.items()}
    return json.dumps(stamp | numbers, separators=(",", ":")).encode()
