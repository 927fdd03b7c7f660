"""The live page: what the server answers, and the page itself in a real Chromium.

`.ci/run` installs a Chromium; elsewhere: `apt-get install chromium`, or `python -m playwright install chromium`.
"""

import http.client
import json
import socket
import struct
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from conftest import Ended, Stream
from tiny_bundle import HEIGHT, POINTS, WIDTH

from fingerflow.player.sources.synthetic import Synthetic
from fingerflow.player.stream import Player

DARK_EACH = 40  # frames of the source


class Served:
    """A stream that plays in a thread while the test looks at its page."""

    def __init__(self, stream: Stream, *arguments: str) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self._stopping = threading.Event()
        self._ended: list[Ended] = []
        self._stream, self._arguments = stream, arguments
        self._thread = threading.Thread(target=self._play)
        self._thread.start()

    def _play(self) -> None:
        source = ("--source", "synthetic", "--rate", "100", "--frames", "3000")
        self._ended.append(self._stream.run(*source, "--page", str(self.port), *self._arguments))

    def ask(self, method: str, path: str, **headers: str) -> tuple[int, bytes]:
        for _ in range(200):
            try:
                connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
                connection.request(method, path, headers=headers)
                answer = connection.getresponse()
                return answer.status, answer.read()
            except ConnectionRefusedError:
                assert self._thread.is_alive(), self._ended
                threading.Event().wait(0.05)
        raise AssertionError("the page was never served")

    def live(self) -> tuple[dict[str, Any], dict[str, np.ndarray[Any, Any]]]:
        """The facts and arrays that the page draws, once there is a picture among them."""
        for _ in range(200):
            _, body = self.ask("GET", "/live")
            (length,) = struct.unpack_from("<I", body)
            facts = json.loads(body[4 : 4 + length])
            place, arrays = 4 + length + -length % 4, {}
            for listed in facts["arrays"]:
                array = np.frombuffer(body, listed["type"], int(np.prod(listed["shape"])), place)
                arrays[listed["name"]] = array.reshape(listed["shape"])
                place += array.nbytes + -array.nbytes % 4
            assert place == len(body)
            if "topography_view" in arrays and len(arrays["traces"]) > 3:
                return facts, arrays
            threading.Event().wait(0.05)
        raise AssertionError("no picture came")

    def restarts(self) -> int:
        return int(self.live()[0]["restarts"])


@pytest.fixture
def served(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:

    running: list[Player] = []
    run = Player.run

    def remember(one: Player) -> dict[str, Any]:
        running.append(one)
        return run(one)

    monkeypatch.setattr(Player, "run", remember)
    read = Synthetic.read

    def read_with_dark_frames(source: Synthetic) -> Any:
        frame = read(source)
        return np.zeros_like(frame) if source._next % DARK_EACH == 0 else frame

    monkeypatch.setattr(Synthetic, "read", read_with_dark_frames)
    found = Served(stream)
    yield found
    running[0].stop()
    found._thread.join(30)
    assert found._ended[0].code == 0


def test_what_is_served(served: Served) -> None:
    facts, arrays = served.live()
    assert set(facts["not_usable"]) <= {"dark"}
    assert arrays["topography_view"].shape == arrays["contact_view"].shape == (HEIGHT, WIDTH)
    assert arrays["real_contact_mask"].sum() * facts["mm_per_px"] ** 2 == pytest.approx(
        facts["scalars"]["real_contact_area"]
    )
    assert arrays["position_px"].shape == (POINTS, 2)
    assert (facts["tracked"], facts["found"], facts["dropped"]) == (POINTS, POINTS, 0)
    assert facts["provider"] == "CPUExecutionProvider"
    assert np.nanmax(arrays["traces"][:, 1]) > 0
    assert served.ask("GET", "/etc/passwd")[0] == 404
    status, page = served.ask("GET", "/")
    assert (status, page[:15]) == (200, b"<!doctype html>")
    assert b"http" not in page  # self-contained: nothing is loaded from elsewhere
    for path, begins in (("/page.css", b":root {"), ("/page.js", b'"use strict";')):
        status, file = served.ask("GET", path)
        assert (status, file[: len(begins)]) == (200, begins)
        assert b"http" not in file


def test_a_restart_is_for_the_page_only(served: Served) -> None:
    """A page of another site may send a POST, but not with this header."""
    assert served.restarts() == 1
    assert served.ask("POST", "/restart")[0] == 403
    assert served.restarts() == 1
    assert served.ask("POST", "/restart", **{"X-Fingerflow": "1"})[0] == 204
    for _ in range(100):
        if served.restarts() == 2:
            return
        threading.Event().wait(0.02)
    raise AssertionError("points were not chosen anew")


COLOURS = """id => {
    const canvas = document.getElementById(id);
    const image = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return new Set(new Uint32Array(image.data.buffer)).size;
}"""
NUMBER = """name => {
    const cells = [...document.querySelectorAll("#numbers div")];
    return cells.find(cell => cell.firstChild.textContent == name).lastChild.textContent.trim();
}"""


def test_the_page_in_a_browser(served: Served, browser: Any) -> None:
    served.live()
    page = browser.new_page()
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    page.goto(f"http://127.0.0.1:{served.port}/")
    page.wait_for_selector("#state:text-is('running')")
    page.wait_for_function(f"({COLOURS})('topography') > 20")
    assert page.evaluate(COLOURS, "contact") > 2  # grey, and what touches in another colour
    assert page.evaluate(COLOURS, "areas") > 5
    assert page.evaluate(NUMBER, "Points") == f"{POINTS} of {POINTS}"
    assert page.evaluate(NUMBER, "Dropped") == "0"
    page.wait_for_function(f"/^[1-9][0-9]* [1-9][0-9]* dark$/.test(({NUMBER})('Not counted'))")
    before = page.evaluate(NUMBER, "Frames")
    page.wait_for_function(f"({NUMBER})('Frames') != {before!r}")
    page.click("#restart")
    page.wait_for_timeout(300)
    assert served.restarts() == 2
    page.close()
    assert not wrong
