"""Tests of the server of the live page against clients other than its page, by bare sockets."""

import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fingerflow.player import page_server as page_module
from fingerflow.player.live_data import LiveData

pytestmark = pytest.mark.long


class Page:
    """A served page that counts its restarts."""

    def __init__(self) -> None:
        self.restarts = 0
        bundle: Any = SimpleNamespace(height=8, width=8, bit_depth=8, folder=Path())
        self.server = page_module.serve_page(("127.0.0.1", 0), LiveData(bundle), dict, self._restart)
        self.port = int(self.server.server_address[1])
        self.host = f"127.0.0.1:{self.port}"

    def _restart(self) -> None:
        self.restarts += 1

    def connect(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=20)

    def say(self, text: str) -> str:
        """Return the answer to a request and everything after it, until the server ends the connection."""
        with self.connect() as client:
            client.sendall(self.signed(text.format(host=self.host)))
            return _rest(client)

    def signed(self, text: str) -> bytes:
        """Return the bytes of requests with the token of the page."""
        return text.replace(" HTTP/1.1\r\n", f" HTTP/1.1\r\nX-Fingerflow: {self.server.token}\r\n").encode()


def _rest(client: socket.socket) -> str:
    parts = []
    while part := client.recv(65536):
        parts.append(part)
    return b"".join(parts).decode("latin-1")


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> Iterator[Page]:
    monkeypatch.setattr(page_module._Handler, "timeout", 0.25)
    monkeypatch.setattr(page_module, "_REQUEST", 1.0)
    served = Page()
    yield served
    served.server.shutdown()
    served.server.server_close()


def test_without_the_token_only_static_files_are_served(page: Page) -> None:
    """What a second user of the computer gets, who has any cookie and any address but no token."""
    token, host = page.server.token, f"Host: {page.host}\r\n\r\n"
    for line, header, status in (
        ("GET /", "", 200),
        ("GET /page.js", "", 200),
        ("GET /live", "", 403),
        ("GET /shown", "", 403),
        ("POST /restart", "", 403),
        ("POST /", "", 403),
        (f"GET /live?token={token}", "", 403),
        ("GET /live", f"Cookie: fingerflow-{page.port}={token}\r\n", 403),
        ("GET /live", f"X-Fingerflow: {token}\r\n", 200),
        ("GET /live", f"X-Fingerflow: {token}x\r\n", 403),
        ("GET /live", "X-Fingerflow: \xe9\r\n", 403),
        ("GET /live", "X-Fingerflow: 1\r\n", 403),
    ):
        with page.connect() as client:
            client.sendall(f"{line} HTTP/1.1\r\n{header}Connection: close\r\n{host}".encode("latin-1"))
            answer = _rest(client)
        assert answer.startswith(f"HTTP/1.1 {status} "), (line, header, answer)
        assert "Set-Cookie" not in answer
        assert token not in answer
    assert page.restarts == 0
    assert page.server.opening == f"http://{page.host}/#token={token}"


@pytest.mark.parametrize(
    ("hosts", "status"),
    [
        ("Host: {host}\r\n", "200"),
        ("Host: LOCALHOST\r\n", "200"),
        ("Host: localhost:1\r\n", "200"),  # a tunnel has another port
        ("Host: 127.0.0.1.evil.example\r\n", "421"),
        ("", "421"),
        ("Host: {host}\r\nHost: evil.example\r\n", "421"),
    ],
)
def test_names_of_this_computer_alone_are_served(page: Page, hosts: str, status: str) -> None:
    """A site whose name points to this computer reads nothing and restarts nothing, and no site may frame the page."""
    answer = page.say(f"GET / HTTP/1.1\r\n{hosts}Connection: close\r\n\r\n")
    assert answer.startswith(f"HTTP/1.1 {status} ")
    assert status == "421" or "frame-ancestors 'none'" in answer
    page.say(f"POST /restart HTTP/1.1\r\n{hosts}Connection: close\r\n\r\n")
    assert page.restarts == (status == "200")


@pytest.mark.parametrize(
    ("lines", "status"),
    [
        ("", 204),
        ("Origin: http://{host}\r\n", 204),
        ("Origin: http://evil.example\r\n", 403),
        ("Origin: https://{host}\r\n", 403),
        ("Origin: null\r\n", 403),
    ],
)
def test_a_restart_is_for_one_origin(page: Page, lines: str, status: int) -> None:
    answer = page.say("POST /restart HTTP/1.1\r\nHost: {host}\r\n" + lines + "\r\n")
    assert answer.startswith(f"HTTP/1.1 {status} ")
    assert page.restarts == (status == 204)


@pytest.mark.parametrize("body", ["Content-Length: {length}", "Transfer-Encoding: chunked", "Content-Length: 0, 9"])
def test_a_body_is_never_a_second_request(page: Page, body: str) -> None:
    """A form of another site may send any text as its body, such as a request for a restart with the header."""
    second = f"POST /restart HTTP/1.1\r\nHost: {page.host}\r\nX-Fingerflow: {page.server.token}\r\n\r\n"
    head = body.replace("{length}", str(len(second)))
    for first in ("POST /restart", "GET /live", "GET /nowhere"):
        answer = page.say(f"{first} HTTP/1.1\r\nHost: {page.host}\r\n{head}\r\n\r\n{second}")
        assert answer.startswith("HTTP/1.1 400 ")
        assert answer.count("HTTP/1.1") == 1
    assert page.restarts == 0


@pytest.mark.parametrize("begun", ["", "GET / HTTP/1.1\r\nHost: x", "a byte at a time"])
def test_a_request_that_is_never_complete_is_left(page: Page, begun: str) -> None:
    with page.connect() as client:
        if not begun.startswith("a byte"):
            client.sendall(begun.encode())
            assert _rest(client) == ""
            return
        for _ in range(100):
            try:
                client.sendall(b"G")
            except OSError:
                return
            threading.Event().wait(0.1)
    raise AssertionError("it was listened to for 10 s")


def test_one_connection_serves_many_requests_and_no_more_after_an_error(page: Page) -> None:
    good = f"GET /page.css HTTP/1.1\r\nHost: {page.host}\r\n\r\n"
    answer = page.say(good + good + good.replace("page.css", "nothing") + good)
    assert [part.split(" ")[0] for part in answer.split("HTTP/1.1 ")[1:]] == ["200", "200", "404"]


def test_no_number_of_connections_keeps_the_owner_out(page: Page) -> None:
    threads = threading.active_count()
    idle = [page.connect() for _ in range(100)]
    with page.connect() as client:
        client.sendall(page.signed(f"GET /live HTTP/1.1\r\nHost: {page.host}\r\nConnection: close\r\n\r\n"))
        assert _rest(client).startswith("HTTP/1.1 200 ")
    for _ in range(100):
        if threading.active_count() - threads <= page_module._CLIENTS:
            break
        threading.Event().wait(0.05)
    else:
        raise AssertionError("connections without the token are kept")
    for client in idle:
        client.close()
