"""Output of live values by Open Sound Control 1.0 over UDP, for Max, Pure Data, SuperCollider or TouchDesigner."""

import struct
from collections.abc import Mapping

from fingerflow.player.outputs.output import FrameStamp, Output
from fingerflow.player.outputs.udp_output import Datagrams

ADDRESS = "osc:HOST:PORT"
_AT_ONCE = b"#bundle\0" + struct.pack(">Q", 1)  # header of an OSC bundle; the time tag 1 means immediately


def open_address(address: str, units: Mapping[str, str]) -> Output:
    """Return an output that sends OSC bundles by UDP to the address HOST:PORT; units are not used."""
    return Datagrams(address, _bundle)


def _bundle(frame: FrameStamp, values: Mapping[str, float]) -> bytes:
    """Return an OSC bundle of a frame with a message `/fingerflow/NAME` for each value.

    Its arguments are the value (float32), NaN where unknown, the number of the frame (int32), camera time and time of
    writing (float64).
    """
    stamp = struct.pack(">idd", frame.number, frame.camera_time, frame.written)
    messages = (
        _padded(f"/fingerflow/{name}") + _padded(",fidd") + struct.pack(">f", value) + stamp
        for name, value in values.items()
    )
    return _AT_ONCE + b"".join(struct.pack(">i", len(message)) + message for message in messages)


def _padded(text: str) -> bytes:
    """Encode a text as an OSC string: append one to four zero bytes, so that the length is a multiple of four."""
    data = text.encode()
    return data + b"\0" * (4 - len(data) % 4)
