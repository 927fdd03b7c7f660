"""HTTP connections of a server, limited in number and in the time of a request."""

import asyncio
from typing import Self

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

_CONNECTIONS = 100  # largest number of simultaneous connections that wait for a request; a browser opens six
_REQUEST = 10.0  # s, longest time for a whole request, however slowly its bytes come


class Connection(H11Protocol):
    """HTTP connection that is closed if its request is not complete in time, or if too many newer ones wait for theirs.

    uvicorn itself waits without end for the rest of a request. Any user of this computer can open connections; only
    complete requests are checked for the token, after which those without it are closed. So it is always the oldest
    that makes room, and no number of connections keeps the owner out.
    """

    connections: set[Self]  # type: ignore[assignment]  # of the server
    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Accept a connection; if too many wait for a request, close the one that has waited longest."""
        super().connection_made(transport)
        self._wait_for_request()
        waiting = {other._deadline.when(): other for other in self.connections if other._deadline}
        if len(waiting) > _CONNECTIONS:
            oldest = waiting[min(waiting)]
            oldest._stop_waiting()
            oldest.transport.abort()

    def data_received(self, data: bytes) -> None:
        """Receive bytes of a request, and start or stop its time limit."""
        super().data_received(data)
        self._wait_for_request()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the time limit of a closed connection."""
        super().connection_lost(exc)
        self._stop_waiting()

    def _wait_for_request(self) -> None:
        if self.conn.their_state not in (h11.IDLE, h11.SEND_BODY):
            self._stop_waiting()
        elif self._deadline is None:
            self._deadline = self.loop.call_later(_REQUEST, self.transport.abort)

    def _stop_waiting(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None
