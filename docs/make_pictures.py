"""Make the pictures of the documentation: `python -m docs.make_pictures`, from the root of the repository.

A synthetic press, and one of a real print, in a real Chromium. Needs the extras `view` and `dev`, Chromium (the
system's, or `python -m playwright install chromium`), and for `own_*.png` a picture of a print, which is no part of
this project: 101_1.tif of FVC2002 DB2 in `../shared/data/fingers`. Without it these pictures stay as they are.
"""

import shutil
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any
from unittest import mock

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import xarray as xr
from PIL import Image
from playwright.sync_api import sync_playwright

import fingerflow
from bench.chromium import launch
from fingerflow import plot
from fingerflow.player import live_frames, page_token
from fingerflow.report import write_report
from fingerflow.results.result import load_result
from fingerflow.schema.recipe import PointSettings, Recipe, ViewRecipe
from fingerflow.synthetic import FingerprintTexture, Press, write_recording
from fingerflow.view.server import Served
from tests.own_press import press_of, write_raw_press
from tests.small_trials import write_library_bundle
from tests.view.walk import walk

PICTURES = Path(__file__).resolve().parent / "pictures"
PRINT = Path(__file__).resolve().parents[2] / "shared" / "data" / "fingers" / "101_1.tif"
HEIGHTS = {"opened": 820, "views": 820, "overlay": 600, "result": 1000, "report": 1100}  # px
FRAMES, SHOWN = 40, 30
WIDTH = 1000  # px
SLOW = 600_000  # ms


def save(data: bytes, name: str) -> None:
    """Save a PNG with 256 colours fitted to the picture, at most `WIDTH` px wide."""
    picture = Image.open(BytesIO(data)).convert("RGB")
    picture.thumbnail((WIDTH, picture.height), Image.Resampling.LANCZOS)
    picture.quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=4, dither=Image.Dither.NONE).save(
        PICTURES / name, optimize=True
    )


def draw_press(result: xr.Dataset, folder: Path) -> None:
    """Draw both views at one moment, with points, outlines and the divergence."""
    scene = fingerflow.load_scene(folder / "scene.toml")
    figure = plt.figure(figsize=(11, 3.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=(1, 1, 1.1))
    plot.picture(result, scene, SHOWN, left, view="topography")
    plot.picture(result, scene, SHOWN, middle, view="contact")
    plot.field_map(result, "divergence", SHOWN, right)
    for axes, title in ((left, "topography view, points"), (middle, "contact view, outlines")):
        axes.set_title(title)
        axes.get_legend().remove()
    held = BytesIO()
    figure.savefig(held, dpi=130, bbox_inches="tight")
    save(held.getvalue(), "press.png")


def screenshot(page: Any, height: int) -> bytes:
    """Return a PNG of a page in a window of this height."""
    page.set_viewport_size({"width": 1280, "height": height})
    page.evaluate("window.scrollTo(0, 0)")
    page.wait_for_timeout(1500)  # until moving elements have come to rest
    return bytes(page.screenshot())


@contextmanager
def opened(browser: Any, path: Path, height: int) -> Iterator[Any]:
    """Yield the page of `fingerflow view` for a file, with its picture drawn."""
    with Served(path) as served:
        page = browser.new_page(viewport={"width": 1280, "height": height})
        page.set_default_timeout(SLOW)
        page.goto(served.address)
        page.wait_for_selector("#picture[data-drawn]")
        yield page
        page.context.close()


def draw_result(browser: Any, path: Path) -> None:
    """Draw the page of a result with its slider at `SHOWN`."""
    with opened(browser, path, 900) as page:
        page.locator("#frame").evaluate(
            f"element => {{ element.value = {SHOWN}; element.dispatchEvent(new Event('input')); }}"
        )
        page.wait_for_selector(f"#picture[data-frame='{SHOWN}']")
        save(screenshot(page, 900), "view_result.png")


def draw_live(browser: Any, folder: Path) -> None:
    """Draw the live page of the synthetic source, after two seconds."""
    recipe = Recipe(views=ViewRecipe(height=192, width=240), tracking=PointSettings(points=150, window_px=15))
    bundle = write_library_bundle(folder / "bundle", recipe)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    with mock.patch.object(page_token.secrets, "token_urlsafe", return_value="token"):
        for stamp, _ in live_frames(bundle, "synthetic", rate=60, page=port, output=folder / "live"):
            if page.url == "about:blank":
                page.goto(f"http://127.0.0.1:{port}/#token=token")
            if stamp.number > 130:
                save(screenshot(page, 1130), "live.png")
                break
    page.context.close()


def draw_walk(browser: Any, folder: Path) -> None:
    """Draw the way from raw files to a report on the page, a picture per step."""
    if not PRINT.is_file():
        print(f"{PRINT} is not here: own_*.png stay as they are")
        return
    write_raw_press(folder, press_of(PRINT))
    with opened(browser, folder / "press.tif", 1000) as page:
        walk(page, lambda name: save(screenshot(page.context.pages[-1], HEIGHTS.get(name, 900)), f"own_{name}.png"))


def main() -> None:
    """Make all pictures in a folder whose name shows on them."""
    folder = Path(tempfile.gettempdir()) / "trial-of-a-press"
    if folder.exists():
        raise SystemExit(f"{folder} exists: remove it, its name is seen on the pictures")
    PICTURES.mkdir(exist_ok=True)
    texture = FingerprintTexture(pattern="loop")
    press = Press(n_frames=FRAMES, frame_rate=float(FRAMES), frames_before_trigger=1, texture=texture)
    try:
        write_recording(folder, press)
        with sync_playwright() as engine:
            browser = launch(engine)
            assert browser is not None, "no Chromium here"
            fingerflow.process(folder / "scene.toml", to=folder / "result.h5").close()
            draw_result(browser, folder / "result.h5")

            result = load_result(folder / "result.h5")
            draw_press(result, folder)
            page = browser.new_page(viewport={"width": 1280, "height": 900})
            page.goto(write_report(result, fingerflow.load_scene(folder / "scene.toml"), folder).as_uri())
            save(screenshot(page, 1150), "report.png")
            draw_live(browser, folder)
            shutil.rmtree(folder)
            draw_walk(browser, folder)
            browser.close()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
