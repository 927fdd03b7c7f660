"""Fixtures of the tests of the page: a synthetic press of 12 small frames, with and without its result."""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from fingerflow import load_scene, process
from fingerflow.synthetic import write_recording
from fingerflow.view.preview import all_of_default_stages
from fingerflow.view.server import Served
from tests.small_trials import TINY_PRESS

PRESS = replace(TINY_PRESS, n_frames=12, frame_rate=12.0)


@pytest.fixture(scope="session")
def processed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a processed press, which no test may write to.

    The folder holds 12 frames of 96 x 240 px, a scene with all files that it names, and `result.h5` with all variables
    that the stages of a default run can compute.
    """
    folder = tmp_path_factory.mktemp("view") / "press"
    write_recording(folder, PRESS)
    scene = folder / "scene.toml"
    process(scene, all_of_default_stages(load_scene(scene)), to=folder / "result.h5").close()
    return folder


@pytest.fixture
def press(processed: Path, tmp_path: Path) -> Path:
    """Return a copy of the folder of the press for one test, without `result.h5`."""
    folder = tmp_path / "press"
    shutil.copytree(processed, folder, ignore=shutil.ignore_patterns("result.h5"))
    return folder


@pytest.fixture(scope="module")
def served(processed: Path) -> Iterator[Served]:
    with Served(processed / "scene.toml") as found:
        yield found
