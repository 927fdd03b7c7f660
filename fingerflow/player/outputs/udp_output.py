"""Output of live values as UDP datagrams, each one JSON object."""

from __future__ import annotations

import socket
from collections.abc import Mapping

from fingerflow.errors import PlayerError
from fingerflow.player.outputs.output import FrameStamp, Output, as_json

ADDRESS = "udp:HOST:PORT"


class Datagrams:
    """Sender of datagrams to one address; it opens no port for others.

    An address without a port, or whose host is unknown, raises PlayerError.
    """

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        if not host or not port.isdigit() or not 0 < int(port) < 65536:
            raise PlayerError(f"{address!r} is no HOST:PORT")
        try:
            family, kind, protocol, _, peer = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_DGRAM)[0]
        except OSError as error:
            raise PlayerError(f"the host {host!r} is not known here ({error.strerror})") from None
        self._socket = socket.socket(family, kind, protocol)
        self._peer = peer

    def write(self, datagram: bytes) -> None:
        """Send a datagram. A port where nobody listens is no error: UDP has no connection."""
        self._socket.sendto(datagram, self._peer)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class JsonOverUdp:
    """Output that sends the live values of each frame as one JSON object in a UDP datagram."""

    def __init__(self, address: str) -> None:
        self._datagrams = Datagrams(address)
        self.close = self._datagrams.close

    def send(self, frame: FrameStamp, values: Mapping[str, float]) -> None:
        """Send the stamp and live values of a frame as one JSON datagram."""
        self._datagrams.write(as_json(frame, values))


def open_address(address: str, units: Mapping[str, str]) -> Output:
    """Return an output that sends JSON datagrams to the address HOST:PORT; units are not used."""
    return JsonOverUdp(address)
