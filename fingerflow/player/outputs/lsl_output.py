"""Output of live values as a stream of the Lab Streaming Layer; needs the package pylsl."""

from collections.abc import Mapping

from fingerflow.player.camera_clock import EPOCH
from fingerflow.player.logged_warnings import log
from fingerflow.player.lsl_clock import load_lsl
from fingerflow.player.outputs.output import FrameStamp

ADDRESS = "lsl:NAME"
# Name and unit of the channels before the values; the time stamp of a sample is the camera time.
_STAMPS = {"frame": "", "written": "s"}


class LslOutlet:
    """Output of live values as a Lab Streaming Layer (LSL) stream: one sample per frame, stamped with the camera time
    on the clock of LSL.

    Channels are the number of the frame, the time of writing on the same clock, and the values, with label and unit.
    """

    def __init__(self, name: str, units: Mapping[str, str]) -> None:
        lsl, offset = load_lsl()
        self._shift = offset - EPOCH  # s, added to Unix time to get LSL time
        channels = _STAMPS | dict(units)
        stream_type = (len(channels), lsl.IRREGULAR_RATE, lsl.cf_double64, f"fingerflow-{name}")
        info = lsl.StreamInfo(name or "fingerflow", "contact", *stream_type)
        described = info.desc().append_child("channels")
        for label, unit in channels.items():
            described.append_child("channel").append_child_value("label", label).append_child_value("unit", unit)
        self._outlet = lsl.StreamOutlet(info)
        log.warning("LSL serves the stream %r to every computer of this network, without a password", info.name())

    def send(self, frame: FrameStamp, values: Mapping[str, float]) -> None:
        """Send the frame number, the time of writing and the live values of a frame as one sample of the stream."""
        sample = [float(frame.number), frame.written + self._shift, *values.values()]
        self._outlet.push_sample(sample, frame.camera_time + self._shift)

    def close(self) -> None:
        """Withdraw the stream from the network."""
        del self._outlet


open_address = LslOutlet
