"""Tests of the live page: the answers of its server, and the page in Chromium.

`.ci/run` installs a Chromium; elsewhere: `apt-get install chromium`, or `python -m playwright install chromium`.
"""

import http.client
import json
import re
import socket
import struct
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from tiny_bundle import HEIGHT, POINTS, WIDTH, Ended, Stream, frame, write_scene

from fingerflow.cli import app
from fingerflow.player import page_token
from fingerflow.player.sources.synthetic_source import Synthetic
from fingerflow.player.stream_player import Player
from fingerflow.schema.variables import VARIABLES

pytestmark = pytest.mark.long

DARK_EACH = 40  # one frame of the source in so many is dark
TOKEN = "token-of-the-test"


class Served:
    """A stream that plays in a thread while the test reads its page."""

    def __init__(self, stream: Stream, *arguments: str) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self._ended: list[Ended] = []
        self._stream, self._arguments = stream, arguments
        self.source: tuple[str, ...] = ("--source", "synthetic", "--rate", "100", "--frames", "3000")
        self._thread = threading.Thread(target=self._play)

    def start(self) -> None:
        self._thread.start()

    def _play(self) -> None:
        self._ended.append(self._stream.run(*self.source, "--page", str(self.port), *self._arguments))

    def ask(self, method: str, path: str, **headers: str) -> tuple[int, bytes]:
        for _ in range(600):
            try:
                connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
                connection.request(method, path, headers={"X-Fingerflow": TOKEN} | headers)
                answer = connection.getresponse()
                return answer.status, answer.read()
            except ConnectionRefusedError:
                assert self._thread.is_alive(), self._ended
                threading.Event().wait(0.05)
        raise AssertionError("the page was never served")

    def live(self) -> tuple[dict[str, Any], dict[str, np.ndarray[Any, Any]]]:
        """Return the facts and the arrays that the page draws, once a picture is among them."""
        for _ in range(200):
            _, body = self.ask("GET", "/live")
            (length,) = struct.unpack_from("<I", body)
            facts = json.loads(body[8 : 8 + length])
            place, arrays = 8 + length + -length % 8, {}
            for listed in facts["arrays"]:
                array = np.frombuffer(body, listed["type"], int(np.prod(listed["shape"])), place)
                arrays[listed["name"]] = array.reshape(listed["shape"])
                place += array.nbytes + -array.nbytes % 8
            assert place == len(body)
            if "topography_view" in arrays and len(arrays["traces"]) > 3:
                return facts, arrays
            threading.Event().wait(0.05)
        raise AssertionError("no picture came")

    def join(self) -> Ended:
        self._thread.join(30)
        return self._ended[0]


@pytest.fixture(autouse=True)
def _known_token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_token.secrets, "token_urlsafe", lambda _: TOKEN)


@pytest.fixture
def running(monkeypatch: pytest.MonkeyPatch) -> list[Player]:
    """Return a list to which every player is added when it starts to run."""
    run, found = Player.run, list[Player]()

    def remember(one: Player) -> dict[str, Any]:
        found.append(one)
        return run(one)

    monkeypatch.setattr(Player, "run", remember)
    return found


@pytest.fixture
def served(stream: Stream, running: list[Player], monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    read = Synthetic.read

    def read_with_dark_frames(source: Synthetic) -> Any:
        frame = read(source)
        return np.zeros_like(frame) if source._next % DARK_EACH == 0 else frame

    monkeypatch.setattr(Synthetic, "read", read_with_dark_frames)
    found = Served(stream)
    found.start()
    yield found
    running[0].stop()  # as after its last frame
    assert found.join().code == 0


def test_what_is_served(served: Served) -> None:
    facts, arrays = served.live()
    assert set(facts["not_usable"]) <= {"dark"}
    assert "shown" not in facts  # sent once, as it does not change
    status, shown = served.ask("GET", "/shown")
    assert (status, json.loads(shown)["real_contact_area"]) == (200, VARIABLES["real_contact_area"].shown())
    assert arrays["topography_view"].shape == arrays["contact_view"].shape == (HEIGHT, WIDTH)
    area = facts["scalars"]["real_contact_area"]
    assert arrays["real_contact_mask"].sum() * facts["mm_per_px"] ** 2 == pytest.approx(area)
    assert (facts["found"], facts["dropped"], facts["computed_by"], facts["state"]) == (POINTS, 0, "native", "running")
    assert POINTS - 3 <= facts["tracked"] <= POINTS  # the finger is a hundred px wide
    # 2 % of a first contact of fifty pixels is one pixel, so that a tolerance of four pixels is added.
    assert area == pytest.approx(facts["expected"]["real_contact_area"], rel=0.02, abs=4 * facts["mm_per_px"] ** 2)
    measured, expected = (
        arrays["traces"][:, facts["trace_columns"].index(name)]
        for name in ("real_contact_area", "expected_real_contact_area")
    )
    usable = np.isfinite(measured)
    np.testing.assert_allclose(measured[usable], expected[usable], rtol=0.02)
    assert served.ask("GET", "/etc/passwd")[0] == 404


COLOURS = """id => {
    const canvas = document.getElementById(id);
    const image = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return new Set(new Uint32Array(image.data.buffer)).size;
}"""
NUMBER = """name => {
    const cells = [...document.querySelectorAll("#numbers div")];
    return cells.find(cell => cell.firstChild.textContent == name).lastChild.textContent.trim();
}"""


STATE = """given => { say(...given); return [$("state").textContent, $("state").className]; }"""
OUTPUTS = """() => {
    outputs({ outputs: [{ output: "<udp>", sent: 9, overtaken: 2, failed: 0, latency_ms: { median: 4.5, p99: 7 } }] });
    const texts = what => [...document.querySelectorAll("#outputs " + what)].map(one => one.textContent);
    return [texts("tr > *"), texts(".bad"), $("outputsCard").hidden];
}"""


def test_the_page_in_a_browser(served: Served, running: list[Player], browser: Any) -> None:
    served.live()
    page = browser.new_page()
    page.set_default_timeout(300_000)  # ms, enough for a busy machine
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
    page.goto(f"http://127.0.0.1:{served.port}/#token={TOKEN}")
    page.wait_for_selector("#state:text-is('running')")
    page.wait_for_function(f"({COLOURS})('topography') > 20")
    assert page.is_hidden("#forcesCard")  # the stream has no forces
    assert page.evaluate(COLOURS, "contact") > 2  # grey levels, and contact in another colour
    assert page.evaluate(COLOURS, "areas") > 5
    assert re.fullmatch(rf"\d+ of {POINTS}", page.evaluate(NUMBER, "Points tracked"))
    assert page.evaluate(NUMBER, "Dropped") == "0 frames"
    counted = "/^[1-9][0-9]* [1-9][0-9]* dark/"
    page.wait_for_function(f"{counted}.test(({NUMBER})('Not counted'))")
    before = page.evaluate(NUMBER, "Frames")
    page.wait_for_function(f"({NUMBER})('Frames') != {before!r}")
    assert page.is_hidden("#outputsCard")  # nothing is sent
    assert page.evaluate(STATE, ["running", "", "7.8 s behind"]) == ["running, 7.8 s behind", "late"]
    assert page.evaluate(STATE, ["running", "", ""]) == ["running", "good"]
    assert page.evaluate(OUTPUTS) == [["<udp>", "9", "2", "0", "4.50", "7.00"], ["2"], False]
    legend = " ".join(page.inner_text("#contactLegend").split())
    assert re.fullmatch("real contact (ellipse of the gross contact|no gross contact)", legend)
    legend = " ".join(page.inner_text("#pointLegend").split())
    assert re.match(r"(\d+ points with divergence: \u2212(\S+ µm/mm) ?\2|0 points with divergence) \d+ not in", legend)
    assert page.is_visible("#divergenceCard")
    page.click("#unit")
    page.wait_for_selector("#divergenceTitle:text-is('Median divergence, %')")
    assert page.inner_text("#unit") == "Deformation in %"
    page.click("#unit")
    page.wait_for_selector("#divergenceTitle:text-is('Median divergence, µm/mm')")
    assert "Real contact area, mm\u00b2" in page.inner_text("#truth")
    page.click("#restart")
    page.wait_for_timeout(300)
    assert served.live()[0]["restarts"] == 2
    for width in (390, 1300):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
    running[0].stop()
    page.wait_for_selector("#state:text-is('ended')")
    assert re.match(r"The stream has ended after \d+ frames, [\d.]+ s. Results: ", page.inner_text("#said"))
    assert page.get_attribute("#state", "class") == ""  # not shown as an error
    page.close()
    assert not wrong


def test_a_page_shows_the_forces_of_its_recording(stream: Stream, running: list[Player], browser: Any) -> None:
    """The page of `fingerflow stream` shows the forces of the scene, each that of the frame of its number, from frame 5
    on.
    """
    rate, first, count = 50.0, 5, 2000
    np.save(stream.bundle / "frames.npy", np.stack([frame(contact_px=50)] * count))
    times = np.arange(0, count / rate, 1e-3)
    forces = np.stack((times, 1 + times * rate / 100, np.full_like(times, 0.25)), axis=1)
    np.savetxt(stream.bundle / "forces.csv", forces, delimiter=",", header="time [s],Fn [N],Ft [N]", comments="")
    write_scene(
        stream.scene,
        f"""[recording]
frames = "frames.npy"
frame_rate = {rate}
first_frame = {first}
[forces]
file = "forces.csv"
normal = "Fn"
tangential = "Ft"
""",
    )
    stream.play = lambda given: app(["stream", *given], standalone_mode=False)
    playing = Served(stream)
    playing.source = ()
    playing.start()
    facts, arrays = playing.live()
    shown = facts["scalars"]
    assert shown["frame"] >= first
    assert shown["normal_force"] == pytest.approx(1 + shown["frame"] / 100, abs=1e-3)
    assert shown["tangential_force"] == pytest.approx(0.25, abs=1e-3)
    normal = arrays["traces"][:, facts["trace_columns"].index("normal_force")]
    assert (np.diff(normal) > 0).all()
    page = browser.new_page()
    page.set_default_timeout(300_000)  # ms, enough for a busy machine
    page.goto(f"http://127.0.0.1:{playing.port}/#token={TOKEN}")
    page.wait_for_selector("#state:text-is('running')")
    page.wait_for_function(f"({COLOURS})('forces') > 5")
    assert re.fullmatch(r"\d\.\d\d N", page.evaluate(NUMBER, "Normal force"))
    assert page.evaluate(NUMBER, "Tangential force") == "0.25 N"
    assert page.inner_text("#forcesLegend").split() == ["normal", "tangential"]
    page.close()
    running[0].stop()
    assert playing.join().code == 0


def test_a_page_shows_why_a_stream_has_failed(stream: Stream, browser: Any) -> None:
    seen = threading.Event()

    def frames() -> Iterator[Any]:
        while not seen.wait(0.01):
            yield frame(contact_px=50)
        yield frame()[:3]

    failing = Served(stream)
    failing.source = stream.frames(frames())
    failing.start()
    failing.live()
    page = browser.new_page()
    page.set_default_timeout(300_000)  # ms, enough for a busy machine
    page.goto(f"http://127.0.0.1:{failing.port}/#token={TOKEN}")
    page.wait_for_selector("#state:text-is('running')")
    seen.set()
    page.wait_for_selector("#state:text-is('stopped by an error')")
    assert re.match(r"The stream was stopped after \d+ frames, [\d.]+ s: .* \(3, ", page.inner_text("#said"))
    assert page.get_attribute("#state", "class") == "gone"
    page.close()
    assert failing.join().code == 2
