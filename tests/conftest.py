"""Fixtures that several folders of tests use."""

import gc
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from filelock import FileLock
from hypothesis import HealthCheck, settings

from bench.chromium import launch
from fingerflow import cli
from fingerflow.kernels import tensors as kernels
from fingerflow.synthetic import write_recording
from tests.small_trials import TINY_PRESS, write_bundle_of_trials, write_small_slip, write_trial
from tests.without_kernels import without_kernels

#: Modules that take longest come first, so that two processes end together. The module that exports a bundle comes
#: long before those that play it, which would wait.
LONGEST = (
    "study/test_simulated_trials.py",
    "export/test_export.py",
    "kernels/test_kernel_sources.py",
    "test_embedded.py",
    "study/test_run.py",
    "view/test_view_walk.py",
    "view/test_view_page.py",
)
HERE = Path(__file__).resolve().parent
SHARED_DATA = HERE.parents[1] / "shared" / "data"

# Examples are the same in every run, whatever earlier runs have stored; a busy machine may take any time.
settings.register_profile(
    "reproducible", derandomize=True, database=None, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("reproducible")


@pytest.hookimpl(tryfirst=True)  # before `-m` selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that need an exported bundle as long, and let the longest modules come first."""
    for item in items:
        if "bundle_of_trials" in getattr(item, "fixturenames", ()):
            item.add_marker("long")
    places = {HERE / name: place for place, name in enumerate(LONGEST)}
    assert all(path.is_file() for path in places), "a module of LONGEST has another name now"
    items.sort(key=lambda item: places.get(item.path, len(LONGEST)))


def pytest_collection_finish() -> None:
    gc.freeze()  # no later collection looks at the objects of all modules
    gc.set_threshold(20_000)  # tracing graphs makes many objects that stay


@pytest.fixture(scope="session", autouse=True)
def _processes_heed_interrupts() -> Iterator[None]:
    """Restore SIGINT where a shell that runs the tests in the background ignores it: processes started by tests inherit
    this, and would run on when a test interrupts them.
    """
    before = signal.getsignal(signal.SIGINT)
    if before == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Return a function that runs the command line in this process and returns its exit code."""

    def run(*arguments: object) -> int:
        monkeypatch.setattr(sys, "argv", ["fingerflow", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            cli.main()
        assert isinstance(stop.value.code, int)
        return stop.value.code

    return run


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of real files with known truth; skip the test if there is none."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"the real recordings are not here: {SHARED_DATA} does not exist")
    return SHARED_DATA


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """Return a folder that all processes of a run share."""
    own = tmp_path_factory.getbasetemp()
    return own if worker_id == "master" else own.parent


@pytest.fixture(scope="session")
def slip_trials(shared_folder: Path) -> Path:
    """Return a folder with the trials `abrupt` and `fading`, which no test may write to: 120 frames, views of 192 x 240
    px, windows that fit a small contact.

    Their scene files do not say where skin touches, as those of a lab.
    """

    def write(folder: Path) -> None:
        for name, friction in (("abrupt", (0.8, 0.4)), ("fading", (0.6, 0.8))):
            timing = {"n_frames": 120, "frames_before_trigger": 6}
            write_small_slip(folder / name, **timing, static_friction=friction[0], kinetic_friction=friction[1])

    return _made_once(shared_folder / "slip", write)


@pytest.fixture(scope="session")
def tiny_press(shared_folder: Path) -> Path:
    """Return the folder of `TINY_PRESS` of tests/small_trials.py, which no test may write to."""
    return _made_once(shared_folder / "tiny_press", lambda path: write_recording(path, TINY_PRESS))


@pytest.fixture(scope="session")
def trials(shared_folder: Path) -> Path:
    """Return a folder with the trials `press` and `slide` of tests/small_trials.py, whose files no test may change."""

    def write(folder: Path) -> None:
        for kind in ("press", "slide"):
            write_trial(folder / kind, kind)

    return _made_once(shared_folder / "trials", write)


@pytest.fixture(scope="session")
def bundle_of_trials(shared_folder: Path) -> Path:
    """Return the bundle that plays the trials of tests/small_trials.py, which no test may write to. The first test that
    needs the bundle exports it, in two minutes: such tests are long.
    """
    return _made_once(shared_folder / "bundle_of_trials", write_bundle_of_trials)


def _made_once(folder: Path, write: Callable[[Path], object]) -> Path:
    """Return a folder that the first process that needs it writes, while all others wait."""
    done = folder.with_name(f"{folder.name}.done")
    with FileLock(f"{folder}.lock"):
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)  # left by a process that failed
            write(folder)
            done.touch()
    return folder


@pytest.fixture
def torch_threads() -> Iterator[Callable[[int], None]]:
    """Yield a function that sets the number of threads of torch, and with it of the package, in this test."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.fixture(params=["compiled", "portable"])
def each_form(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the test with the compiled kernels and without."""
    if request.param == "portable":
        without_kernels(monkeypatch)
    elif not kernels.serve():
        pytest.skip("the compiled kernels were not built or are turned off")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Yield a running Chromium, Playwright's own or the system's."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as engine:
        started = launch(engine)
        if started is None:
            pytest.skip("no Chromium here: `apt-get install chromium` or `python -m playwright install chromium`")
        yield started
        started.close()
