"""Output of live values as UDP datagrams, each one JSON object."""

import socket
from collections.abc import Callable, Mapping

from fingerflow.errors import PlayerError
from fingerflow.player.outputs.output import FrameStamp, Output, as_json

ADDRESS = "udp:HOST:PORT"


class Datagrams:
    """Output that sends each frame as one UDP datagram to the address HOST:PORT; it opens no port for others.

    `encode` returns the bytes of the stamp and the live values of a frame. An address without a port, or whose host is
    unknown, raises PlayerError.
    """

    def __init__(self, address: str, encode: Callable[[FrameStamp, Mapping[str, float]], bytes]) -> None:
        host, _, port = address.rpartition(":")
        if not host or not port.isdigit() or not 0 < int(port) < 65536:
            raise PlayerError(f"{address!r} is no HOST:PORT")
        try:
            addresses = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_DGRAM)
        except OSError as error:
            raise PlayerError(f"the host {host!r} is not known here ({error.strerror})") from None
        family, socket_type, protocol, _, peer = addresses[0]
        self._socket = socket.socket(family, socket_type, protocol)
        self._peer, self._encode = peer, encode
        self.close = self._socket.close

    def send(self, frame: FrameStamp, values: Mapping[str, float]) -> None:
        """Send a frame. A port where nobody listens is no error: UDP has no connection."""
        self._socket.sendto(self._encode(frame, values), self._peer)


def open_address(address: str, units: Mapping[str, str]) -> Output:
    """Return an output that sends JSON datagrams to the address HOST:PORT; units are not used."""
    return Datagrams(address, as_json)
