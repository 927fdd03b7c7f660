"""Processing time of the recordings of a study on a GPU: one by one, and together (`process_together`).

Presses of other skin motion each, from files to results in memory, all outputs; 64 frames, two views of 512 x 640 px
and 700 points (9 frames of 96 x 120 px with --quick). `calls` are the operations of torch a frame, views and mere
memory left out, of the portable form: what an accelerator is called for by the host, which for a few hundred points is
what takes the time. They are counted on the processor, where `calls_to_peer` is the ratio to one by one. `deviation` is
the largest difference of a position from one by one, px; infinite where a point is found in one and not in the other.
frames/s are those of a graphics processor, None without CUDA: a processor with the compiled library gains nothing.
"""

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
import xarray as xr
from torch.utils._python_dispatch import TorchDispatchMode

from bench.launches import is_call
from bench.recordings import write_quietly
from bench.rows import Row
from fingerflow.pipeline.run import process_together
from fingerflow.synthetic import Press

_SMALL: dict[str, Any] = {"frame_shape": (96, 240), "finger": (1.8, 1.5), "semi_axes": (1.3, 1.1)}
_SHIFTS = [
    (0.12, -0.08),
    (-0.1, 0.1),
    (0.0, 0.15),
    (0.14, 0.02),
    (-0.15, -0.05),
    (0.05, -0.14),
    (0.1, 0.1),
    (-0.05, 0.0),
]


def run(quick: bool) -> list[Row]:
    """Return two rows for each number of recordings."""
    frames, numbers = (9, (1, 2)) if quick else (64, (1, 2, 4, 8))
    with tempfile.TemporaryDirectory() as folder:
        scenes = [_written(Path(folder) / f"{number}", frames, number, quick) for number in range(numbers[-1])]
        return [row for number in numbers for row in _rows(scenes[:number], frames * number)]


def _written(folder: Path, frames: int, number: int, small: bool) -> Path:
    size = _SMALL if small else {}
    press = Press(n_frames=frames, frame_rate=64.0, frames_before_trigger=2, shift=_SHIFTS[number], **size)
    write_quietly(folder, press)
    return folder / "scene.toml"


def _rows(scenes: Sequence[Path], frames: int) -> list[Row]:
    cuda = torch.cuda.is_available()
    rows: list[Row] = []
    peer: tuple[int, list[xr.Dataset]] | None = None
    for way, go in _WAYS.items():
        with _Calls() as counter:
            found = go(scenes, device="cpu", engine="torch")
        peer = peer or (counter.calls, found)
        rows.append(
            {
                "recordings": len(scenes),
                "way": way,
                "calls": counter.calls / frames,
                "calls_to_peer": counter.calls / peer[0],
                "deviation": max(map(_deviation, found, peer[1])),
                "frames_per_second": _rate(go, scenes, frames) if cuda else None,
            }
        )
    return rows


def _one_by_one(scenes: Sequence[Path], device: str, engine: str) -> list[xr.Dataset]:
    # Not by `process`: a part of it runs in a thread that is not counted.
    return [process_together([scene], device=device, engine=engine)[0] for scene in scenes]


_WAYS: dict[str, Callable[..., list[xr.Dataset]]] = {"one by one": _one_by_one, "together": process_together}


def _rate(go: Callable[..., list[xr.Dataset]], scenes: Sequence[Path], frames: int) -> float:
    """Return frames a second of the second run, after a run of warm-up."""
    for _ in range(2):
        begun = time.perf_counter()
        go(scenes, device="cuda", engine="torch")
    return frames / (time.perf_counter() - begun)


def _deviation(found: xr.Dataset, expected: xr.Dataset) -> float:
    one, other = (data["position_px"].values for data in (found, expected))
    if one.shape != other.shape or (np.isfinite(one) != np.isfinite(other)).any():
        return float("inf")
    return float(np.nanmax(np.abs(one - other)))


class _Calls(TorchDispatchMode):
    """Counter of calls; under a dispatch mode the portable form computes, as on an accelerator."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]  # torch's states no types
        self.calls = 0

    def __torch_dispatch__(self, operation: Any, types: Any, arguments: Any = (), options: Any = None) -> Any:
        self.calls += is_call(operation)
        return operation(*arguments, **(options or {}))
