"""Tests that memory is bounded whatever the length of a recording: only numbers grow with the frames, not pixels."""

import gc
import tracemalloc
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import xarray as xr

from fingerflow import process
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.recordings import Recording
from fingerflow.results.result import load_result
from fingerflow.schema.scene import Scene

pytestmark = pytest.mark.long


@pytest.fixture(autouse=True)
def _cycles_are_let_go() -> Iterator[None]:
    """Exclude existing objects from garbage collection, so that cycles of earlier tests do not delay the collection of
    new ones.
    """
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()


class Watch:
    """Counter of the frames read, image-sized tensors and bytes of NumPy arrays that are alive at once."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, pixels: int) -> None:
        self.frames = self.most_frames = self.most_tensors = 0
        self._pixels = pixels
        self._batches = 0
        run = ContactStage.step

        def counted_read(recording: Recording) -> np.ndarray[Any, Any]:
            frames = recording.read()  # as from a file that must be decoded
            self.frames += len(frames)
            self.most_frames = max(self.most_frames, self.frames)
            weakref.finalize(frames, self._let_go, len(frames))
            return frames

        def counted_run(stage: ContactStage, *arguments: Any) -> Any:
            self._batches += 1
            if self._batches % 4 == 2:  # a search of all objects takes time
                self.most_tensors = max(self.most_tensors, self._tensors())
            return run(stage, *arguments)

        monkeypatch.setattr(Recording, "mapped", counted_read)
        monkeypatch.setattr(ContactStage, "step", counted_run)

    def _tensors(self) -> int:
        found = [part.numel() for part in gc.get_objects() if type(part) is torch.Tensor]
        return sum(size for size in found if size >= self._pixels) // self._pixels

    def _let_go(self, count: int) -> None:
        self.frames -= count


@pytest.fixture
def long(changed: Callable[..., Scene], frames: np.ndarray[Any, Any], tmp_path: Path) -> Callable[..., Scene]:
    """Return a function that writes a scene of so many frames to disk, of which the six with contact repeat."""

    def make(count: int, points: int = 12) -> Scene:
        smaller = {"points = 700": f"points = {points}", "window_px = 25": "window_px = 9"}
        scene = changed(smaller, forces=False, frames=frames[:1])
        shape = (count, *frames.shape[1:])
        file = np.lib.format.open_memmap(tmp_path / "frames.npy", mode="w+", dtype=frames.dtype, shape=shape)
        for index in range(count):
            file[index] = frames[2 + index % 6]
        return scene

    return make


def test_what_is_alive_does_not_grow_with_the_frames(
    long: Callable[..., Scene], monkeypatch: pytest.MonkeyPatch
) -> None:
    few, many = 24, 120
    process(long(9))  # fills caches
    found = {}
    for count in (few, many):
        scene = long(count)
        with monkeypatch.context() as patch:
            watch = Watch(patch, pixels=96 * 120)
            gc.collect()
            tracemalloc.start()
            result = process(scene)
            found[count] = watch.most_frames, watch.most_tensors, tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            assert watch.frames == 0
        assert result.sizes["frame"] == count
        assert (result["gross_contact_area"].values > 0).all()
    (few_frames, few_tensors, few_bytes), (many_frames, many_tensors, many_bytes) = found[few], found[many]
    assert many_frames == few_frames <= 16
    assert many_tensors == few_tensors
    # A frame has 23,040 bytes. Only numbers remain: areas, and some 100 bytes per point and triangle.
    assert (many_bytes - few_bytes) / (many - few) < 23_040 / 4


def test_results_that_go_to_a_file_do_not_stay_in_memory(long: Callable[..., Scene], tmp_path: Path) -> None:
    """Results written to a file are the same data set, but only a few numbers per frame, and none per point or
    triangle, stay in memory.
    """
    file = tmp_path / "result.h5"
    process(long(9), to=file).close()
    bytes_of: dict[Path | None, list[int]] = {file: [], None: []}
    # More than the 64 frames that are computed at a time, and so many that one chunk of 64 frames more or less at
    # the peak, which depends on the time of writing, has little effect.
    few, many = 80, 400
    for count in (few, many):
        scene = long(count, points=60)
        for to, found in bytes_of.items():
            gc.collect()
            tracemalloc.start()
            made = process(scene, to=to)
            made.close()
            found.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    a_frame = {to: (last - first) / (many - few) for to, (first, last) in bytes_of.items()}
    assert a_frame[file] < 1000  # some forty numbers, and offsets of chunks in the file
    assert a_frame[file] < a_frame[None] / 5
    xr.testing.assert_identical(load_result(file).drop_attrs(deep=False), made.drop_attrs(deep=False).drop_encoding())
    assert [path.name for path in tmp_path.iterdir() if path.suffix == ".h5"] == ["result.h5"]
