"""A press in a small frame, and scenes made of it by changing one thing."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fingerflow import load_scene
from fingerflow.schema.scene import Scene

Change = Callable[..., Scene]


@pytest.fixture(scope="session")
def press(tiny_press: Path) -> Path:
    return tiny_press


@pytest.fixture(scope="session")
def frames(press: Path) -> np.ndarray[Any, Any]:
    return np.asarray(np.load(press / "frames.npy"))


@pytest.fixture
def changed(press: Path, tmp_path: Path) -> Change:
    """The scene with other texts and other arrays: ``changed({"points = 700": "points = 20"}, frames=array)``."""

    def change(
        replaced: dict[str, str] | None = None,
        /,
        *,
        forces: bool = True,
        stream: bool = True,
        **arrays: np.ndarray[Any, Any],
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
        if not stream:
            text = text[: text.index("[stream]")]
        for old, new in (replaced or {}).items():
            assert old in text, old
            text = text.replace(old, new)
        (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
        return load_scene(tmp_path / "scene.toml")

    return change
