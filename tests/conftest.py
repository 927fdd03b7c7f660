"""Fixtures that more than one room of tests uses."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from filelock import FileLock

from bench.chromium import launch
from fingerflow import kernels
from fingerflow.synthetic import PartialSlip, write_recording
from tests.small_trials import write_bundle_of_trials

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real files with known truth; the test is skipped where it is absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"the real recordings are not here: {SHARED_DATA} does not exist")
    return SHARED_DATA


@pytest.fixture(scope="session")
def slip_trials(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders `abrupt` and `fading`: trials of 120 frames, views of 192 x 240 px, windows that fit a small contact.

    Their scene files do not say where skin touches: a lab's do not either.
    """
    folder = tmp_path_factory.mktemp("slip")
    for name, friction in (("abrupt", (0.8, 0.4)), ("fading", (0.6, 0.8))):
        trial = PartialSlip(
            n_frames=120,
            frames_before_trigger=6,
            frame_shape=(192, 480),
            finger=(3.2, 2.7),
            semi_axes=(2.3, 1.9),
            creep=0.45,
            travel=0.8,
            static_friction=friction[0],
            kinetic_friction=friction[1],
        )
        write_recording(folder / name, trial)
        scene = folder / name / "scene.toml"
        text = scene.read_text(encoding="utf-8")
        for old, new in (("window_px = 25", "window_px = 15"), ("min_distance_px = 6.0", "min_distance_px = 4.0")):
            assert old in text
            text = text.replace(old, new)
        scene.write_text(text[: text.index("[stream]")], encoding="utf-8")
    return folder


@pytest.fixture(scope="session")
def bundle_of_trials(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """What plays `small_trials`, not to be written to: exported once, in a minute, by the first that needs it."""
    own = tmp_path_factory.getbasetemp()
    folder = (own if worker_id == "master" else own.parent) / "bundle_of_trials"
    with FileLock(f"{folder}.lock"):
        return folder if folder.exists() else write_bundle_of_trials(folder)


@pytest.fixture
def torch_threads() -> Iterator[Callable[[int], None]]:
    """Sets the number of threads that torch, and with it the package, may use in this test."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.fixture(params=["compiled", "portable"])
def each_form(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test runs with the compiled kernels and without."""
    if request.param == "portable":
        monkeypatch.setattr(kernels, "serve", lambda *tensors: False)
    elif not kernels.serve():
        pytest.skip("the compiled kernels were not built or are turned off")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Playwright's own Chromium, or the system's."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as engine:
        started = launch(engine)
        if started is None:
            pytest.skip("no Chromium here: `apt-get install chromium` or `python -m playwright install chromium`")
        yield started
        started.close()
