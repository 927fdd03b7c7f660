"""Fixtures: a press in small frames, and scenes that differ from the press in one thing."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fingerflow.schema.scene import Scene
from tests.small_trials import scene_beside

Change = Callable[..., Scene]


@pytest.fixture(scope="session")
def press(tiny_press: Path) -> Path:
    return tiny_press


@pytest.fixture(scope="session")
def frames(press: Path) -> np.ndarray[Any, Any]:
    return np.load(press / "frames.npy")


@pytest.fixture
def changed(press: Path, tmp_path: Path) -> Change:
    """Return a function that writes the scene with other texts and arrays: ``changed({"points = 700": "points = 20"},
    frames=array)``.
    """
    return partial(scene_beside, press, tmp_path)
