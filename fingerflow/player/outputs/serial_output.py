"""Output to a serial line: a fixed text, as a trigger sends, or a line of JSON per frame."""

from collections.abc import Mapping

from fingerflow.player.outputs.output import FrameStamp, Output, as_json
from fingerflow.player.serial_line import FORM, SerialLine, open_line

ADDRESS = f"{FORM}[:TEXT]"


class SerialOutput:
    """Output to a serial line, which writes for each frame that it is sent the same text or, without a text, the live
    values as a line of JSON.
    """

    def __init__(self, line: SerialLine, text: str) -> None:
        self._line, self._text = line, text.encode()
        self.close = line.close

    def send(self, frame: FrameStamp, values: Mapping[str, float]) -> None:
        """Write the fixed text or, without one, the stamp and live values of a frame as a line of JSON."""
        self._line.write(self._text or as_json(frame, values) + b"\n")


def open_address(address: str, units: Mapping[str, str]) -> Output:
    """Open the serial line of an address DEVICE[@BAUD][:TEXT], and return an output that writes TEXT, or JSON without
    it; units are not used.
    """
    device, _, text = address.partition(":")
    return SerialOutput(open_line(device), text)
