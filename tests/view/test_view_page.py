"""Tests of the page in Chromium: from a recording to its result, and requests of a page of another site."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

import numpy as np
import pytest

from fingerflow import load_scene
from fingerflow.results.result import load_result
from fingerflow.view.redirect import redirect_file
from fingerflow.view.server import Served
from tests.view.walk import choose, fill, set_value, show_frame
from tests.view.walk import drag as drag_in

pytestmark = pytest.mark.long

WIDTH = 240  # px of a frame
SLOW = 120_000  # ms, enough to load torch on a busy machine


@contextmanager
def opened(browser: Any, path: Path, width: int = 1300, refused: str = "none") -> Iterator[tuple[Any, Served]]:
    """Open the page of a path in the browser; yield the page and its server.

    On leaving, fail if the page has requested anything from another server, or has reported an error that does not
    contain `refused`.
    """
    with Served(path) as served:
        context = browser.new_context(viewport={"width": width, "height": 900}, accept_downloads=True)
        page = context.new_page()
        page.set_default_timeout(SLOW)
        asked: list[str] = []
        wrong: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
        page.goto(served.address)
        page.wait_for_selector("#picture[data-drawn]")
        yield page, served
        context.close()
        assert len(asked) > 10
        assert {urlparse(url).netloc for url in asked if not url.startswith("blob:")} == {f"127.0.0.1:{served.port}"}
        assert not [one for one in wrong if refused not in one]


def text_of(page: Any, selector: str) -> str:
    return str(page.inner_text(selector))


drag = partial(drag_in, frame_width=WIDTH)


def orange(page: Any) -> int:
    """Return the number of pixels of the picture in the colour of contact."""
    return int(
        page.evaluate(
            """() => {
    const canvas = document.getElementById("picture"), out = canvas.getContext("2d");
    const { data } = out.getImageData(0, 0, canvas.width, canvas.height);
    let count = 0;
    for (let i = 0; i < data.length; i += 4) if (data[i] - data[i + 2] > 80 && data[i] > data[i + 1]) count++;
    return count;
}"""
        )
    )


def area_of(page: Any) -> float:
    """Return the real contact area (mm²) that the page states while a scene is set up."""
    found = page.wait_for_function("() => document.querySelectorAll('#panel dd')[1]?.firstChild.data")
    return float(found.json_value())


def draw_around(page: Any, corners: list[tuple[float, float]]) -> None:
    """Draw a region with the mouse through corners (x, y) in px of the frame."""
    page.click("#region")
    box = page.locator("#picture").bounding_box()
    for k, (x, y) in enumerate(corners):
        page.mouse.move(box["x"] + (x + 0.5) * box["width"] / WIDTH, box["y"] + (y + 0.5) * box["width"] / WIDTH)
        if k == 0:
            page.mouse.down()
    page.mouse.up()


def test_from_a_recording_to_its_result(browser: Any, press: Path) -> None:
    written = load_scene(press / "scene.toml")
    (press / "scene.toml").rename(press / "kept.txt")
    # Requests for forces are refused as long as the force file has no channel.
    with opened(browser, press / "frames.npy", refused="422 (") as (page, _):
        # Frames are shown before any setting is given.
        page.wait_for_selector("#problems")
        assert "Background: recording of the empty glass is needed" in text_of(page, "#problems")
        assert "Cannot process: 3 problems in Background, Calibration, Recording" in text_of(page, "#setup-status")
        assert page.is_disabled("#process")
        show_frame(page, 9)
        assert "frame 9 of 0–11" in text_of(page, "#where")

        # Fill in the settings that the page cannot find in the recording.
        fill(page, "recording.frame_rate", "12")
        fill(page, "recording.trigger_frame", "1")
        fill(page, "background.frames", "empty.npy")
        fill(page, "background.dark", "dark.npy")
        fill(page, "calibration.mm_per_px", str(written.calibration.mm_per_px))
        fill(page, "calibration.topography_to_contact", json.dumps(written.calibration.topography_to_contact))
        fill(page, "forces.file", "forces.csv")
        choose(page, "forces.normal", "normal_force")
        page.wait_for_selector("#picture[data-mask=true]")
        page.wait_for_selector("#courses:not([hidden])")

        # Contact follows the threshold at once.
        before = orange(page)
        assert before > 500
        set_value(page, '[aria-label="contact.threshold number"]', 0.6)
        page.wait_for_function("() => document.querySelector('#panel dd').textContent.trim() == '0.6'")
        page.wait_for_function("() => document.getElementById('picture').dataset.mask == 'true'")
        assert orange(page) < before / 2  # few pixels lose more than 0.6 of the light
        page.select_option('[aria-label="contact.threshold"]', "reference_frame")
        page.wait_for_function("() => document.querySelector('#panel dd').textContent.trim() != '0.6'")

        # Drag an edge of a view.
        drag(page, (239, 50), (231, 50))
        page.wait_for_function("() => document.getElementById('text').textContent.includes('[120, 23')")

        # Limit the contact to a region, and remove the region again.
        whole, area = area_of(page), "+document.querySelectorAll('#panel dd')[1]?.firstChild.data"
        draw_around(page, [(150, 20), (178, 20), (178, 80), (150, 80), (150, 24)])
        page.wait_for_selector("#no-region", state="visible")
        page.wait_for_function(f"whole => {area} < whole", arg=whole)
        assert "[views.contact.region]" in page.text_content("#text")
        page.click("#no-region")
        page.wait_for_function(f"whole => {area} == whole", arg=whole)
        assert "\n[views.contact.region]" not in page.text_content("#text")

        # Write the scene: it has the settings of the page.
        page.click("#write")
        page.wait_for_selector(".good:has-text('has these settings')")
        scene = load_scene(press / "scene.toml")
        assert scene.views.contact.rows == (0, 96)
        assert scene.views.contact.columns == (120, pytest.approx(232, abs=1))
        assert scene.contact.threshold == "reference_frame"
        assert scene.recording.trigger_frame == 1

        # Process the scene: the page shows the result.
        page.click("#process")
        page.wait_for_selector("#tab-results.on")
        page.wait_for_selector("#map")
        result = load_result(press / "result.h5")
        largest = int(result["normal_force"].argmax())
        page.wait_for_selector(f"#picture[data-frame='{largest}'][data-mask=true]")
        said = page.evaluate(
            "() => [...document.querySelectorAll('#panel dt')].find(one => one.textContent == 'real contact area')"
            ".nextSibling.textContent"
        )
        assert float(said.partition(" ")[0]) == pytest.approx(float(result["real_contact_area"][largest]), rel=1e-3)


def test_a_tab_that_is_closed_during_processing_loses_nothing(browser: Any, press: Path) -> None:
    """The run goes on, and the next tab shows its result when it has ended."""
    with opened(browser, press / "scene.toml") as (page, served):
        page.click("#process")
        page.wait_for_selector("#progress progress")
        again = page.context.new_page()
        again.set_default_timeout(SLOW)
        page.close()
        again.goto(served.address)
        again.wait_for_selector("#tab-results.on")
        again.wait_for_selector("#map")
    assert load_result(press / "result.h5").sizes["frame"] == 12


def test_a_file_of_somebody_else_is_asked_about(browser: Any, press: Path) -> None:
    with opened(browser, press / "scene.toml", refused="409 (Conflict)") as (page, _):
        page.wait_for_selector("#picture[data-mask=true]")
        (press / "scene.toml").write_text("# mine\n", encoding="utf-8")
        fill(page, "tracking.points", "50")
        page.wait_for_function("() => document.getElementById('text').textContent.includes('points = 50')")
        page.click("#write")
        page.wait_for_selector("#replace")
        assert (press / "scene.toml").read_text(encoding="utf-8") == "# mine\n"

        # An answer that arrives while the question is shown does not replace its element, so that a click on it counts.
        asked = page.query_selector("#replace")
        fill(page, "tracking.points", "60")
        page.wait_for_function("() => document.getElementById('text').textContent.includes('points = 60')")
        page.wait_for_selector("#legend:has-text('of 60 points')")  # the points arrive after the text
        assert asked.is_visible()
        page.click("#keep")
        page.wait_for_selector("#ask", state="detached")
        assert (press / "scene.toml").read_text(encoding="utf-8") == "# mine\n"

        page.click("#write")
        page.click("#replace")
        page.wait_for_selector(".good:has-text('has these settings')")
        page.wait_for_selector("#ask", state="detached")
        assert load_scene(press / "scene.toml").tracking.points == 60


def test_what_has_had_no_answer_is_written_with_the_next_change(browser: Any, press: Path) -> None:
    """A setting whose request failed, as when the computer slept, is reported as not written, stays in its field, and
    is written with the next click on Write.
    """
    with opened(browser, press / "scene.toml", refused="net::ERR_FAILED") as (page, _):
        page.wait_for_selector("#legend:has-text('points, seeded in frame')")
        page.route("**/api/edit", lambda route: route.abort(), times=1)
        fill(page, "tracking.points", "50")
        page.wait_for_selector("#error:not([hidden])")
        page.wait_for_selector(".good:has-text('Not written yet')")
        assert page.input_value('[aria-label="tracking.points"]') == "50"
        assert page.is_disabled("#process")
        page.click("#write")
        page.wait_for_selector(".good:has-text('has these settings')")
        assert page.is_hidden("#error")
    assert load_scene(press / "scene.toml").tracking.points == 50


def test_what_is_refused_is_said_and_seen_no_more(browser: Any, press: Path) -> None:
    """A setting that the server refuses is reported, its field shows the value before, and nothing is written. All
    other settings are kept and are written with the next click on Write.
    """
    late: list[Any] = []
    with opened(browser, press / "scene.toml", refused="422 (") as (page, _):
        page.wait_for_selector("#legend:has-text('points, seeded in frame')")
        before = page.input_value('[aria-label="contact.median_px"]')
        # One route for the whole test: when the last of several is used up, the browser lets waiting requests pass.
        answers = [late.append, lambda route: route.continue_(post_data=_spoiled(route.request))]
        page.route("**/api/edit", lambda route: answers.pop(0)(route) if answers else route.continue_())
        with page.expect_request("**/api/edit"):
            fill(page, "tracking.points", "50")
        set_value(page, '[aria-label="contact.median_px"]', 9)
        fill(page, "tracking.min_distance_px", "5")
        page.click("#write")
        late[0].continue_()
        page.wait_for_selector("#error:has-text('kind is')")
        page.wait_for_selector("#legend:has-text('of 50 points')")
        assert "kind is 'x'" in text_of(page, "#error")
        assert load_scene(press / "scene.toml").tracking.points == 700  # nothing is written
        page.click("#write")
        page.wait_for_selector(".good:has-text('has these settings')")
        assert page.is_hidden("#error")
        assert page.input_value('[aria-label="contact.median_px"]') == before
    written = load_scene(press / "scene.toml").tracking
    assert (written.points, written.min_distance_px) == (50, 5)


def _spoiled(request: Any) -> str:
    """Return the body of a request with the key `contact.median_px` replaced by `kind = "x"`, which is refused."""
    given = request.post_data_json["set"]
    return json.dumps({"set": [["kind", "x"] if key == "contact.median_px" else [key, value] for key, value in given]})


def test_a_result_is_looked_at(browser: Any, processed: Path, tmp_path: Path) -> None:
    result = load_result(processed / "result.h5")
    with opened(browser, processed / "result.h5", 400) as (page, _):
        page.wait_for_selector("#picture[data-mask=true]")
        assert page.evaluate("() => document.documentElement.scrollWidth <= window.innerWidth")
        show_frame(page, 8)
        # Click a point: the page shows its number and in which frames it was tracked.
        known = np.flatnonzero(np.isfinite(result["divergence"].values[8]))
        point = int(known[len(known) // 2])
        x, y = result["position_px"].values[8, point] + 0.5
        drag(page, (x, y), (x, y))
        page.wait_for_function(f"() => document.querySelector('#point dd')?.textContent == '{point}'")
        assert "tracked in" in text_of(page, "#point")

        # Every variable of the menu is drawn without an error.
        for key in page.eval_on_selector_all("#map option", "all => all.map(one => one.value)"):
            page.select_option("#map", key)
            drawn = int(page.get_attribute("#picture", "data-drawn"))
            page.wait_for_function(f"() => document.getElementById('picture').dataset.drawn >= {drawn}")
        page.select_option("#map", "curl")
        page.wait_for_selector("#legend .scale")
        assert page.is_hidden("#error"), text_of(page, "#error")

        # Draw a region: the page counts the points in it and plots their median.
        draw_around(page, [(0, 0), (119, 0), (119, 95), (0, 95), (0, 2)])  # the topography view
        page.wait_for_function("() => /points, selected in frame 8/.test(document.getElementById('point').textContent)")
        inside = int(np.isfinite(result["position"].values[8]).all(-1).sum())
        assert abs(int(text_of(page, "#point").split()[0]) - inside) <= 0.05 * inside

        # A click on a curve shows that frame in the picture.
        chart = page.locator("#chart").bounding_box()
        page.locator("#chart").click(position={"x": chart["width"] - 16, "y": 60})
        page.wait_for_selector("#picture[data-frame='11']")

        # One button changes the unit of deformation.
        shown = page.locator("#panel dl div:has(dt:text-is('median divergence')) dd").first  # 88.4 ± 7.3
        micrometres = np.array(shown.inner_text().split(" ± "), float)
        page.click("#unit")
        page.wait_for_selector("#panel dl div:has(dt:text-is('median divergence')) dd.unit:text-is('%')")
        percent = np.array(shown.inner_text().split(" ± "), float)
        assert percent == pytest.approx(micrometres / 10, rel=2e-3)
        page.click("#unit")
        page.wait_for_selector("#panel dl div:has(dt:text-is('median divergence')) dd.unit:text-is('µm/mm')")

        # Picture, chart and tables can be saved.
        begins = {"save-png": b"\x89PNG", "save-svg": b"<svg", "save-csv": b"point,x (mm)", "chart-png": b"\x89PNG"}
        for button, first in {**begins, "chart-svg": b"<svg", "chart-csv": b"frame,time (s),normal_force (N)"}.items():
            with page.expect_download() as loading:
                page.click(f"#{button}")
            loading.value.save_as(tmp_path / button)
            assert (tmp_path / button).read_bytes().startswith(first)
        header = (tmp_path / "chart-csv").read_text(encoding="utf-8").partition("\n")[0]
        assert "curl of median of" in header


def test_a_file_that_only_its_owner_reads_opens_the_page(browser: Any, press: Path) -> None:
    """The page is opened through a file that only its owner can read, so that the token stands in no command line of a
    browser, which every user of the computer can list.
    """
    with Served(press / "scene.toml") as served, redirect_file(served.address) as path:
        if os.name == "posix":
            assert path.parent.stat().st_mode & 0o077 == 0
        page = browser.new_page()
        page.set_default_timeout(SLOW)
        page.goto(path.as_uri())
        page.wait_for_selector("#picture[data-drawn]")
        assert "token" not in page.url
        page.close()
    assert not path.exists()
