"""Cases of what other users of the computer, other sites in the browser and foreign files could make fingerflow do."""

import csv
import http.client
import socket
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np

from fingerflow.player.live_data import LiveData
from fingerflow.player.page_server import serve_page
from fingerflow.schema.spreadsheet_cell import quoted_cell
from fingerflow.study.cluster import run_on_workers
from fingerflow.view import connection
from fingerflow.view.redirect import redirect_file
from fingerflow.view.server import Served
from tests.silent.case import Case
from tests.study.test_cluster import _asks_as_somebody_else, _raise

_PATHS = ("/", "/live", "/page.js", "/api/setup", "/api/frame?frame=0", "/report.html", "/?token=", "/?token=guess")
_HALVES = (
    b"",
    b"GET / HT",
    b"GET / HTTP/1.1\r\nHost: x",
    b"POST /api/edit HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\n{",
)
_FORMULAS = ("=1+1", "+cmd|' /C calc'!A0", "-2+3", "@SUM(A1)", "\t=1", "p01", "-0.5")


def cases() -> Iterator[Case]:
    """Yield the cases; the numbers count requests, connections or cells."""
    with tempfile.TemporaryDirectory() as folder, mock.patch.object(connection, "_REQUEST", 1.0):
        yield from _pages(Path(folder))
        yield _command_line(Path(folder))
        yield _scheduler()
        yield _cells(Path(folder))


def _case(name: str, wrong: int, count: int, stated: str) -> Case:
    return Case(name, f"{wrong} of {count}", f"0 of {count}", stated, "open" if wrong else "refused")


def _pages(folder: Path) -> Iterator[Case]:
    bundle: Any = SimpleNamespace(height=8, width=8, bit_depth=8, folder=folder)
    live = serve_page(("127.0.0.1", 0), LiveData(bundle), dict, lambda: None)
    frames = folder / "frames.npy"
    np.save(frames, np.zeros((3, 32, 32), np.uint8))
    with Served(frames) as view, mock.patch("fingerflow.player.page_server._REQUEST", 1.0):
        for name, port in (("page of view", view.port), ("live page", int(live.server_address[1]))):
            statuses = [_status(port, method, path) for path in _PATHS for method in ("GET", "POST")]
            yield _case(f"{name}: requests without its token", sum(one < 400 for one in statuses), len(statuses), "403")
            kept = sum(not _is_ended(port, begun) for begun in _HALVES)
            yield _case(f"{name}: requests that are never complete", kept, len(_HALVES), "closed")
    live.shutdown()
    live.server_close()


def _status(port: int, method: str, path: str) -> int:
    line = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    line.request(method, path, headers={"X-Fingerflow": "1"})
    return line.getresponse().status


def _is_ended(port: int, begun: bytes) -> bool:
    with socket.create_connection(("127.0.0.1", port), timeout=60) as line:
        line.sendall(begun)
        try:
            while line.recv(65536):
                pass
        except ConnectionError:
            return True
        except TimeoutError:
            return False
    return True


def _command_line(folder: Path) -> Case:
    """Judge how the token reaches the browser: everybody can read its command line, so the token is in a file that only
    the owner can read.
    """
    with redirect_file("http://127.0.0.1:1/?token=secret") as path:
        sleeping = subprocess.Popen([sys.executable, "-c", "input()", path.as_uri()], stdin=subprocess.PIPE)
        listed = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True, check=True).stdout
        sleeping.communicate(b"\n")
        others = stat.S_IMODE(path.parent.stat().st_mode) & 0o077
    return _case(
        "token in a command line, or in a file for others", ("token=secret" in listed) + bool(others), 2, "file"
    )


def _scheduler() -> Case:
    ((_, answers),) = run_on_workers(_asks_as_somebody_else, iter([("", 1)]), 1, _raise, workers=1, progress=False)
    return _case("scheduler of a study: without its certificate", answers.count("let in"), 2, "TLS")


def _cells(folder: Path) -> Case:
    table = folder / "cells.csv"
    with table.open("w", newline="") as file:
        csv.writer(file).writerow([quoted_cell(one) for one in _FORMULAS])
    with table.open(newline="") as file:
        (cells,) = csv.reader(file)
    run = sum(one[:1] in "=+-@\t\r" and one != "-0.5" for one in cells)
    return _case("cells that a spreadsheet would run", run, len(_FORMULAS), "apostrophe")
