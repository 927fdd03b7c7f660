"""Output of live values by ZeroMQ, each message one JSON object; needs the package pyzmq."""

from collections.abc import Mapping

from fingerflow.errors import PlayerError
from fingerflow.player.named_objects import load_library
from fingerflow.player.outputs.output import FrameStamp, as_json

ADDRESS = "zeromq:tcp://HOST:PORT"
_LINGER = 500  # ms for which queued messages wait for a receiver when the output is closed


class ZeroMq:
    """Output of live values as JSON messages to a ZeroMQ socket of type PULL that the receiver has bound; the player
    opens no port.

    The address is tcp://HOST:PORT; units are not used.

    PUSH reports a message that nobody can take, which PUB drops in silence: without a receiver, or while the receiver
    is slower than the frames, messages count as failed.
    """

    def __init__(self, address: str, units: Mapping[str, str]) -> None:
        self._zmq = load_library("zmq", "pyzmq")
        if "://" not in address:
            raise PlayerError(f"{address!r} is no tcp://HOST:PORT")
        self._context = self._zmq.Context()
        self._socket = self._context.socket(self._zmq.PUSH)
        self._socket.setsockopt(self._zmq.SNDHWM, 1)
        self._socket.setsockopt(self._zmq.IMMEDIATE, 1)  # queues no message for a receiver that is not connected
        self._socket.setsockopt(self._zmq.LINGER, _LINGER)
        self._socket.connect(address)

    def send(self, frame: FrameStamp, values: Mapping[str, float]) -> None:
        """Send the stamp and live values of a frame as one JSON message; raise OSError if no receiver takes it now."""
        try:
            self._socket.send(as_json(frame, values), self._zmq.NOBLOCK)
        except self._zmq.Again:
            raise OSError("no receiver takes messages") from None

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
        self._context.term()


open_address = ZeroMq
