"""A press in a small frame, and scenes made of it by changing one thing."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fingerflow import load_scene
from fingerflow.schema.scene import Scene
from fingerflow.synthetic import write_recording
from tests.small_trials import TINY_PRESS

Change = Callable[..., Scene]


@pytest.fixture(scope="session")
def press(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("small") / "press"
    write_recording(folder, TINY_PRESS)
    return folder


@pytest.fixture(scope="session")
def frames(press: Path) -> np.ndarray[Any, Any]:
    return np.asarray(np.load(press / "frames.npy"))


@pytest.fixture
def changed(press: Path, tmp_path: Path) -> Change:
    """The scene with other texts and other arrays: ``changed({"points = 700": "points = 20"}, frames=array)``."""

    def change(
        replaced: dict[str, str] | None = None, /, *, forces: bool = True, **arrays: np.ndarray[Any, Any]
    ) -> Scene:
        text = (press / "scene.toml").read_text(encoding="utf-8")
        for name in ("frames.npy", "empty.npy", "dark.npy", "forces.csv"):
            text = text.replace(f'"{name}"', f'"{(press / name).as_posix()}"')
        for name, values in arrays.items():
            np.save(tmp_path / f"{name}.npy", values)
            text = text.replace(f'"{(press / name).as_posix()}.npy"', f'"{name}.npy"')
        if not forces:
            begin, end = text.index("[forces]"), text.index("[calibration]")
            text = text[:begin] + text[end:]
        for old, new in (replaced or {}).items():
            assert old in text, old
            text = text.replace(old, new)
        (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
        return load_scene(tmp_path / "scene.toml")

    return change
