"""HTTP server of the live page: static files, the definitions of the variables shown, the live data, and a request to
choose new points to track.

The page is served to this computer and to those that its address is bound for. Its static files are the same for all;
requests of data without the token of the printed address, for another host name, from pages of other sites, or with a
body are refused. The number of clients without the token and the duration of a request are limited.
"""

from __future__ import annotations

import contextlib
import json
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from fingerflow.errors import PlayerError, first_line
from fingerflow.player.live_data import SHOWN, LiveData
from fingerflow.player.logged_warnings import log
from fingerflow.player.page_token import HEADER, is_token, new_token

_TIMEOUT = 5.0  # s to wait for data from a client, or for a client to accept a response; the page polls every 66 ms
_REQUEST = 10.0  # s, longest time for a whole request, however slowly its bytes come
_LINGER = 0.5  # s without data after which the body of a refused request is read no further
_MOST_BODY = 1 << 20  # bytes of such a body that are read
_CLIENTS = 16  # largest number of simultaneous connections on which no request with the token has come
# s for which the server outlives the stream: a page polls 15 times a second, or once a second in the background.
_LAST_LOOK = 1.2
_FILES = {"/": ("index.html", "html"), "/page.css": ("page.css", "css"), "/page.js": ("page.js", "javascript")}
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}


def serve_page(
    address: tuple[str, int], live: LiveData, facts: Callable[[], Mapping[str, Any]], restart: Callable[[], None]
) -> PageServer:
    """Start the server of the live page in a new thread, and return the server.

    Args:
        address: host and port; port 0 takes a free one.
        live: data that the page draws.
        facts: returns the current values that the page shows in addition.
        restart: called when the user requests new points.

    Raises PlayerError where the address is in use.
    """
    folder = Path(__file__).with_name("page")
    absent = 404, "text/plain", b"not here"
    texts = {
        path: (f"text/{kind}; charset=utf-8", (folder / name).read_bytes()) for path, (name, kind) in _FILES.items()
    }
    fixed = {path: (200, *text) for path, text in texts.items()}
    fixed["/shown"] = 200, "application/json", json.dumps(SHOWN).encode()

    class Handler(_Handler):
        def do_GET(self) -> None:
            if not self.is_refused():
                body = (200, "application/octet-stream", live.packed(facts())) if self.path == "/live" else None
                self.answer(*(body or fixed.get(self.path, absent)))

        def do_POST(self) -> None:
            if not self.is_refused():
                if is_restart := self.path == "/restart":
                    restart()
                self.answer(*((204, "text/plain", b"") if is_restart else absent))

    try:
        server = PageServer(address, Handler, live)
    except OSError as error:
        raise PlayerError(
            f"live page: {address[0]}:{address[1]} cannot be served ({error.strerror}); give --page another port or off"
        ) from None
    threading.Thread(target=server.serve_forever, name="page", daemon=True).start()
    log.info("live page: %s", server.opening)
    return server


class PageServer(ThreadingHTTPServer):
    """HTTP server of the live page, with a time limit for requests and a limit of connections without the token.

    Attributes:
        opening: address that opens the page, with the token.
    """

    daemon_threads, request_queue_size = True, 128  # connections that wait to be accepted

    def __init__(self, address: tuple[str, int], handler: type[_Handler], live: LiveData) -> None:
        self._live = live
        self.host, self.token = address[0], new_token()
        # Sockets on which no request with the token has come, oldest first, and when the present request began.
        self.asking: dict[socket.socket, float] = {}
        super().__init__(address, handler)
        host, port = self.server_address[:2]
        self.opening = f"http://{host!s}:{port}/#token={self.token}"

    def stop(self) -> None:
        """Stop the server of the live page, with a short delay in which an open page shows the end of the stream."""
        if self._live.is_watched():
            time.sleep(_LAST_LOOK)
        self.shutdown()
        self.server_close()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a client in its own thread; if there are too many without the token, close the oldest connection, so
        that no number of them keeps the owner out.
        """
        self.asking[request] = time.monotonic()
        self._leave(list(self.asking)[:-_CLIENTS])
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a client until its connection ends."""
        super().process_request_thread(request, client_address)
        self.asking.pop(request, None)

    def service_actions(self) -> None:
        """Close the connections of clients whose request takes too long; called twice a second by the server loop."""
        now = time.monotonic()
        self._leave([connection for connection, since in list(self.asking.items()) if now - since > _REQUEST])

    def _leave(self, connections: Iterable[socket.socket]) -> None:
        for connection in connections:
            self.asking.pop(connection, None)
            with contextlib.suppress(OSError):  # the client has closed the connection
                connection.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log an error of a request in one line; lost connections are not logged."""
        error = sys.exc_info()[1]
        if error is not None and not isinstance(error, OSError):
            log.warning("live page: %s: %s", type(error).__name__, first_line(error))


class _Handler(BaseHTTPRequestHandler):
    """Request handler that refuses requests with a body, for a foreign host name, or from pages of other sites."""

    protocol_version = "HTTP/1.1"
    server_version, sys_version = "fingerflow", ""
    timeout = _TIMEOUT
    server: PageServer
    _admitted = False  # whether a request on this connection had the token

    def handle_one_request(self) -> None:
        """Handle one request of a client, with a time limit that starts when the server begins to wait for it."""
        if not self._admitted and self.connection in self.server.asking:
            self.server.asking[self.connection] = time.monotonic()
        super().handle_one_request()

    def is_refused(self) -> bool:
        """Return True if the request is refused, which is answered here."""
        hosts = self.headers.get_all("Host", [])
        origin = self.headers.get("Origin")
        lengths = self.headers.get_all("Content-Length", ["0"])
        if self.headers.get("Transfer-Encoding") is not None or lengths != ["0"]:
            # The body is not parsed; on a connection that stays open it would be taken for the next request.
            self.answer(400, "text/plain", b"requests have no body here")
            # The rest of the body is discarded, as closing the connection earlier would lose the response.
            self.connection.shutdown(socket.SHUT_WR)
            self.connection.settimeout(_LINGER)
            taken = 0
            while taken < _MOST_BODY and (part := self.connection.recv(65536)):
                taken += len(part)
            return True
        if len(hosts) != 1 or not self._means_this_computer(_name(hosts[0])):
            self.answer(421, "text/plain", b"this address is not served under that name")
            return True
        if origin is not None and origin.lower() != f"http://{hosts[0]}".lower():
            self.answer(403, "text/plain", b"pages of other sites are refused")
            return True
        if is_token(self.headers.get(HEADER, ""), self.server.token):
            self._admitted = True
            self.server.asking.pop(self.connection, None)
        elif self.command != "GET" or self.path not in _FILES:
            self.answer(403, "text/plain", b"open the whole address that the player has printed")
            return True
        return False

    def answer(self, status: int, content_type: str, body: bytes) -> None:
        """Send a complete response with an HTTP status, a content type and a body; an error status ends the
        connection.
        """
        self.send_response(status)
        self.send_header("Content-Type", content_type)
        self.send_header("Content-Length", str(len(body)))
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        if status >= 400:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing, because the page sends fifteen requests a second."""

    def _means_this_computer(self, name: str) -> bool:
        """Return whether a host name, from the Host header of a request, means this computer and can mean no other.

        Any other name may be a DNS rebinding attack.
        """
        here = str(self.connection.getsockname()[0])
        names = {here, self.server.host.lower(), self.server.server_name.lower(), socket.gethostname().lower()}
        return name in names - {"", "0.0.0.0"} or (name == "localhost" and here.startswith("127."))


def _name(host: str) -> str:
    """Return the host name of an HTTP Host header, in lower case and without a port."""
    name, _, port = host.strip().lower().rpartition(":")
    return name if name and port.isdigit() else host.strip().lower()
