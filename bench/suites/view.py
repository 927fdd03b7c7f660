"""Speed of the page of `fingerflow view` in headless Chromium: time to first image, and frame rate of the slider.

Two views of 512 x 640 px with mask, ellipse and 700 points in the colours of their divergence, drawn in software; in
full of 3,000 frames. By the clock, and in CPU time of server and browser, which says what an idle computer can do:
divided by its cores it is the time that a frame takes at least.
"""

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from bench.chromium import launch
from bench.recordings import write_quietly
from bench.rows import Row, Skipped
from fingerflow import process
from fingerflow.synthetic import Press
from fingerflow.view.server import Served

_LONG, _SCRUBBED = 3000, 120  # frames
_STRIDE = 7  # frames between two requests
_SCRUB = """async ([count, stride, frames]) => {
    const slider = document.getElementById("frame"), picture = document.getElementById("picture");
    for (let k = 1; k <= count; k++) {
        const wanted = String(Math.round(k * stride) % frames);
        slider.value = wanted;
        slider.dispatchEvent(new Event("input"));
        while (picture.dataset.frame !== wanted) await new Promise(requestAnimationFrame);
    }
}"""


def run(quick: bool = False) -> Sequence[Row]:
    """Return a row for the first picture and one for a frame under the slider."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        raise Skipped("playwright is not installed: pip install playwright") from None
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as engine:
        browser = launch(engine)
        if browser is None:
            raise Skipped("no Chromium here: python -m playwright install chromium")
        frames = 24 if quick else _LONG
        scene = _recorded(Path(folder), frames)
        process(scene, to=scene.parent / "result.h5").close()
        with Served(scene.parent / "result.h5") as served:
            rows = _measured(browser, served.address, frames, 10 if quick else _SCRUBBED)
        browser.close()
    return rows


def _measured(browser: Any, address: str, frames: int, count: int) -> list[Row]:
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    clock, spent = time.perf_counter(), _cpu()
    page.goto(address)
    page.wait_for_selector("#picture[data-drawn]")
    rows = [_row("first picture", 1, clock, spent)]
    page.wait_for_selector("#picture[data-mask=true]")  # torch is loaded
    page.wait_for_timeout(1000)
    clock, spent = time.perf_counter(), _cpu()
    page.evaluate(_SCRUB, [count, _STRIDE, frames])
    return [*rows, _row(f"a frame of {frames}, scrubbed", count, clock, spent)]


def _row(what: str, count: int, clock: float, spent: tuple[float, float]) -> Row:
    wall = (time.perf_counter() - clock) / count
    server, browser = ((now - then) / count for now, then in zip(_cpu(), spent, strict=True))
    return {
        "what": what,
        "ms by the clock": 1e3 * wall,
        "a second": 1 / wall,
        "CPU ms of the server": 1e3 * server,
        "CPU ms of the browser": 1e3 * browser,
        "load": psutil.getloadavg()[0],
    }


def _cpu() -> tuple[float, float]:
    """Return processor seconds of this process and of its children."""
    own = psutil.Process()
    others = 0.0
    for one in own.children(recursive=True):
        try:
            times = one.cpu_times()
        except psutil.NoSuchProcess:
            continue
        others += times.user + times.system
    return time.process_time(), others


def _recorded(folder: Path, frames: int) -> Path:
    """Write a press that plays forwards and backwards for ``frames`` frames; return its scene file."""
    press = Press(n_frames=min(frames, 300))
    write_quietly(folder / "press", press)
    scene = folder / "press" / "scene.toml"
    if frames > press.n_frames:
        once = np.load(folder / "press" / "frames.npy", mmap_mode="r")
        turns = np.concatenate([np.arange(len(once)), np.arange(len(once))[::-1]])
        many = np.lib.format.open_memmap(folder / "many.npy", "w+", once.dtype, (frames, *once.shape[1:]))
        for k in range(frames):
            many[k] = once[turns[k % len(turns)]]
        many.flush()
        del once
        (folder / "many.npy").replace(folder / "press" / "frames.npy")
        text = scene.read_text(encoding="utf-8")  # forces are those of one press
        scene.write_text(text[: text.index("[forces]")] + text[text.index("[calibration]") :], encoding="utf-8")
    return scene
