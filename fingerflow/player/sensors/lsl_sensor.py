"""Force sensor that is a stream of the Lab Streaming Layer; needs the package pylsl."""

from fingerflow.errors import PlayerError
from fingerflow.player.lsl_clock import load_lsl
from fingerflow.player.sensors.sensor import ForceSample, parse_sample

ADDRESS = "lsl:NAME"
_FINDING, _WAITING = 5.0, 0.2  # s to find the stream, and to wait for a sample


class LslSensor:
    """Force sensor that is a Lab Streaming Layer (LSL) stream: its channels `normal_force` and `tangential_force` or,
    without these names, its first one to three.

    The times of samples are the stream's own, on the clock of this computer. A stream that cannot be found, or whose
    channels are not in N, raises PlayerError.
    """

    def __init__(self, name: str) -> None:
        lsl, self._shift = load_lsl()
        streams = lsl.resolve_byprop("name", name, timeout=_FINDING)
        if not streams:
            raise PlayerError(f"no LSL stream has the name {name!r} in this network")
        self._inlet = lsl.StreamInlet(streams[0], processing_flags=lsl.proc_clocksync)
        self.close = self._inlet.close_stream
        info = self._inlet.info(_FINDING)
        labels = info.get_channel_labels() or []
        units = info.get_channel_units() or []
        named = [labels.index(force) for force in ("normal_force", "tangential_force") if force in labels]
        if named and "normal_force" not in labels:
            raise PlayerError(f"the LSL stream {name!r} names a tangential_force only; name its normal_force, too")
        self._places = named or range(min(3, info.channel_count()))
        wrong = [unit for place, unit in enumerate(units) if place in self._places and unit not in (None, "", "N")]
        if wrong:
            raise PlayerError(f"the LSL stream {name!r} has forces in {wrong[0]}; send them in N")

    def read(self) -> ForceSample | None:
        """Return the next sample of the stream, with its time on the axis of `time.perf_counter`; None if none came for
        0.2 s.
        """
        sample, time = self._inlet.pull_sample(timeout=_WAITING)
        if sample is None:
            return None
        return parse_sample(time - self._shift, [float(sample[channel]) for channel in self._places])


open_address = LslSensor
