"""Simulated recordings on disk, and their results from `fingerflow.process`."""

import tempfile
from collections.abc import Iterable
from pathlib import Path

import xarray as xr

from fingerflow import process
from fingerflow.synthetic import Press, SyntheticScene, write_recording

#: The press of suites with --quick.
QUICK_PRESS = Press(
    n_frames=24,
    frame_rate=24.0,
    frames_before_trigger=1,
    frame_shape=(224, 560),
    finger=(3.6, 3.1),
    semi_axes=(2.6, 2.2),
)


def write_quietly(folder: Path, scene: SyntheticScene) -> None:
    """Write a recording without a progress bar between the tables."""
    write_recording(folder, scene, progress=False)


def processed(scene: SyntheticScene, outputs: Iterable[str] | None = None) -> xr.Dataset:
    """Return the result of `process` for a scene, whose recording lies in a temporary folder meanwhile."""
    with tempfile.TemporaryDirectory() as folder:
        write_quietly(Path(folder) / "recording", scene)
        return process(Path(folder) / "recording" / "scene.toml", outputs)
