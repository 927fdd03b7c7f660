"""Test that memory is bounded whatever the length of a recording."""

import gc
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from fingerflow import process
from fingerflow.recordings import Recording
from fingerflow.results.result import load_result
from fingerflow.schema.scene import Scene
from tests.pipeline.stages.conftest import Change


def scene_of(count: int, changed: Change, frames: np.ndarray[Any, Any], folder: Path) -> Scene:
    """Write a scene of so many frames to disk, of which the six with contact repeat."""
    smaller = {"points = 700": "points = 200", "window_px = 25": "window_px = 9"}
    scene = changed(smaller, forces=False, frames=frames[:1])
    np.save(folder / "frames.npy", frames[2 + np.arange(count) % 6])
    return scene


@pytest.mark.long
def test_what_stays_in_memory_does_not_grow_with_the_frames(
    changed: Change, frames: np.ndarray[Any, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Results written to a file are the same data set, but only a few numbers per frame, and none per pixel, point or
    triangle, stay in memory.
    """
    monkeypatch.setattr(Recording, "mapped", Recording.read)  # as from a file that must be decoded
    file = tmp_path / "result.h5"
    process(scene_of(9, changed, frames, tmp_path), to=file).close()  # fills caches
    peaks = []
    # More than the 64 frames that are computed at a time, and so many that one chunk of 64 frames more or less at
    # the peak, which depends on the time of writing, has little effect.
    few, many = 80, 720
    gc.collect()
    gc.freeze()  # cycles of earlier tests do not delay the collection of new ones
    for count in (few, many):
        scene = scene_of(count, changed, frames, tmp_path)
        gc.collect()
        tracemalloc.start()
        process(scene, to=file).close()
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    gc.unfreeze()
    made = process(scene)
    a_frame = (peaks[1] - peaks[0]) / (many - few)
    # Of 23,040 bytes a frame: some 150 numbers and offsets of chunks in the file; a float32 of each point has 800.
    assert a_frame < 2000
    assert a_frame < made.nbytes / many / 5
    xr.testing.assert_identical(load_result(file).drop_attrs(deep=False), made.drop_attrs(deep=False).drop_encoding())
    assert [path.name for path in tmp_path.iterdir() if path.suffix == ".h5"] == ["result.h5"]
