"""The live page: three files, and what they ask of a stream."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from .errors import PlayerError
from .live import LiveData

log = logging.getLogger("fingerflow.player")


_FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
}


def serve_page(
    address: tuple[str, int], live: LiveData, facts: Callable[[], Mapping[str, Any]], restart: Callable[[], None]
) -> ThreadingHTTPServer:
    """Starts the live page in a thread of its own.

    Args:
        address: host and port; port 0 takes a free one.
        live: what the page draws.
        facts: what the page says besides, now.
        restart: called where somebody asks for other points.

    Raises PlayerError where the address is taken.
    """
    folder = Path(__file__).with_name("page")
    files = {path: ((folder / name).read_bytes(), kind) for path, (name, kind) in _FILES.items()}

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            if self.path in files:
                body, kind = files[self.path]
                self._answer(200, kind, body)
            elif self.path == "/live":
                self._answer(200, "application/octet-stream", live.packed(facts()))
            else:
                self._answer(404, "text/plain", b"not here")

        def do_POST(self) -> None:
            # A page of another site cannot send this header: the stream is restarted by its own page only.
            if self.path == "/restart" and self.headers.get("X-Fingerflow"):
                restart()
                self._answer(204, "text/plain", b"")
            else:
                self._answer(403, "text/plain", b"refused")

        def _answer(self, status: int, kind: str, body: bytes) -> None:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:
            """Fifteen requests a second are no news."""

    try:
        server = ThreadingHTTPServer(address, Handler)
    except OSError as error:
        raise PlayerError(
            f"live page: {address[0]}:{address[1]} cannot be served ({error.strerror}); give --page another port or off"
        ) from None
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, name="page", daemon=True).start()
    log.info("live page: http://%s:%d/", *server.server_address[:2])
    return server
