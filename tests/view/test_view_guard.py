"""Tests of who is answered: the page itself, opened by the printed address, and nobody else."""

import http.client
import re
import socket
from pathlib import Path

import pytest

from fingerflow.errors import FingerflowError
from fingerflow.view import connection as connection_module
from fingerflow.view.server import Served

Answer = tuple[int, dict[str, str], bytes]
SLOW = 300  # s, enough for a busy machine


def ask(served: Served, path: str, method: str = "GET", body: str | None = None, **headers: str) -> Answer:
    connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=SLOW)
    connection.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
    answer = connection.getresponse()
    found = answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
    connection.close()
    return found


@pytest.fixture(scope="module")
def token(served: Served) -> str:
    """Return the token of the printed address, which requests of the page carry in a header."""
    return served.address.partition("/#token=")[2]


def test_the_page_and_its_files_are_answered_and_may_load_nothing_from_elsewhere(served: Served, token: str) -> None:
    status, headers, page = ask(served, "/", X_Fingerflow=token)
    assert (status, page[:15].lower()) == (200, b"<!doctype html>")
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    names = re.findall(rb'(?:src|href)="([^"]+)"', page)
    names += [name.encode() for name in ("net.js", "pens.js", "chart.js", "results.js", "setup.js")]
    for name in names:
        status, _, content = ask(served, f"/{name.decode()}", X_Fingerflow=token)
        assert status == 200
        assert not re.search(rb"""(?:src|href|from|import|fetch)[^\n]{0,12}["'`]https?:""", content)


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"Host": "127.0.0.1:1"}, 421),
        ({"Host": "example.org"}, 421),  # a foreign name whose DNS entry points to this computer
        ({"Origin": "http://example.org"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "http://127.0.0.1:1"}, 403),  # a page of another port
    ],
)
def test_requests_are_answered_or_refused_by_host_and_origin(
    served: Served, token: str, headers: dict[str, str], status: int
) -> None:
    assert ask(served, "/api/setup", X_Fingerflow=token, **headers)[0] == status


def test_without_the_token_only_static_files_are_answered(served: Served, token: str, processed: Path) -> None:
    """A server of another user, on another port of this computer, is sent nothing that opens the page: no cookie is
    set, and neither the fragment of an address nor session storage reaches it.
    """
    before = (processed / "scene.toml").read_bytes()
    body = '{"set": [["contact.median_px", 5]]}'
    for headers in ({}, {"X_Fingerflow": "1"}, {"X_Fingerflow": token + "x"}, {"Cookie": f"fingerflow={token}"}):
        for path in ("/api/setup", f"/api/setup?token={token}", "/api/folder?at=..", "/api/calibration.png"):
            assert ask(served, path, **headers)[0] == 403
        for path in ("/api/edit", "/api/write", "/api/process"):
            assert ask(served, path, "POST", body, **headers)[0] == 403
        assert ask(served, "/report.html", **headers)[0] == 404
    status, headers, page = ask(served, "/")
    assert (status, headers["connection"]) == (200, "close")
    assert "set-cookie" not in headers
    assert token.encode() not in page
    assert ask(served, "/api/write", "POST", "no JSON", X_Fingerflow=token)[0] == 422
    assert (processed / "scene.toml").read_bytes() == before


def test_files_beside_the_page_are_not_served(served: Served, token: str) -> None:
    for path in ("/../server.py", "/%2e%2e/server.py", "//etc/passwd", "/..%2fguard.py"):
        assert ask(served, path, X_Fingerflow=token)[0] == 404


def test_two_names_in_one_request_are_refused(served: Served, token: str) -> None:
    with socket.create_connection(("127.0.0.1", served.port), timeout=SLOW) as line:
        text = f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{served.port}\r\nHost: example.org\r\nX-Fingerflow: {token}\r\n\r\n"
        line.sendall(text.encode())
        assert line.recv(200).split()[1] in (b"400", b"421")


def test_a_byte_now_and_then_does_not_keep_a_connection(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection_module, "_REQUEST", 0.5)
    with socket.create_connection(("127.0.0.1", served.port), timeout=0.05) as line:
        while True:
            try:
                line.sendall(b"G")
                if not read(line):
                    return
            except TimeoutError:
                continue
            except ConnectionError:
                return


def test_no_number_of_connections_keeps_the_owner_out(served: Served, token: str) -> None:
    idle = [socket.create_connection(("127.0.0.1", served.port), timeout=SLOW) for _ in range(900)]
    assert ask(served, "/api/ready", X_Fingerflow=token)[0] == 200
    assert [read(line) for line in idle[:700]] == [b""] * 700  # the oldest made room
    for line in idle:
        line.close()


def read(line: socket.socket) -> bytes:
    """Return the bytes that have arrived, or none at the end of the connection."""
    try:
        return line.recv(65536)
    except ConnectionError:
        return b""


def test_a_port_that_is_taken_is_named(served: Served, processed: Path) -> None:
    with pytest.raises(FingerflowError, match=f"port {served.port} .*give another --port"):
        Served(processed / "scene.toml", served.port)
