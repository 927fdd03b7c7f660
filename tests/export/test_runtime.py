"""Tests of modules run by ONNX Runtime: they are called like the module itself and give the same results."""

import os
import warnings
from pathlib import Path
from typing import ClassVar, NamedTuple

import pytest
import torch
from torch import Tensor, nn

from fingerflow.errors import FingerflowError
from fingerflow.export.runtime import OnnxRuntime


class Pair(NamedTuple):
    first: Tensor
    second: Tensor | None


class Scaled(nn.Module):
    """Takes and returns what graphs take and return: named tuples, None, settings, tensors of one recording and
    of all.
    """

    def __init__(self, factor: float) -> None:
        super().__init__()
        self.factor = factor
        self.register_buffer("offset", torch.tensor([0.5]))

    def forward(self, frames: Tensor, pair: Pair, shared: Tensor, *, deep: bool = False) -> Pair:
        second = None if pair.second is None else pair.second + shared[:, 0, 2, None]
        return Pair((frames.float() * self.factor + pair.first) * (2 if deep else 1) + self.offset, second)

    def largest(self, frames: Tensor) -> Tensor:
        return frames.float().amax((1, 2))


class Spread(nn.Module):
    """Returns the distances of points from their mean, the mean, and the pair; points may be NaN."""

    point_axes: ClassVar = {"points": 1, "pair": 2}

    def forward(self, points: Tensor, pair: Pair) -> tuple[Tensor, Tensor, Pair]:
        known = points.isfinite().all(-1, keepdim=True)
        mean = torch.where(known, points, 0.0).sum(1, keepdim=True) / known.sum(1, keepdim=True)
        return points - mean, mean, Pair(pair.first, (points[..., 0, None] + pair.first.transpose(1, 2)).sum(2))


class Branching(nn.Module):
    def forward(self, frames: Tensor) -> Tensor:
        return frames + 1 if frames.sum() > 0 else frames


@pytest.fixture
def runtime(tmp_path: Path) -> OnnxRuntime:
    return OnnxRuntime(1, tmp_path / "graphs")


@pytest.mark.long
@pytest.mark.parametrize("second", [False, True])
def test_a_module_gives_the_same(runtime: OnnxRuntime, second: bool) -> None:
    """ONNX Runtime gives the results of the module, with the same graphs for one recording and for several."""
    module = Scaled(3.0)
    executed = runtime(module)
    generator = torch.Generator().manual_seed(2)
    for batch in (2, 1, 5):
        frames = torch.randint(0, 255, (batch, 4, 6), generator=generator, dtype=torch.uint8)
        other = torch.rand(batch, 3, generator=generator) if second else None
        pair = Pair(torch.rand(1, 4, 6, generator=generator), other)
        matrix = torch.rand(1, 2, 3, generator=generator)
        for deep in (False, True):
            expected, found = (one(frames, pair, matrix, deep=deep) for one in (module, executed))
            assert isinstance(found, Pair)
            torch.testing.assert_close(found.first, expected.first)
            assert found.second is None if expected.second is None else torch.equal(found.second, expected.second)
        assert torch.equal(executed.largest(frames), module.largest(frames))
        assert runtime.exported == 3
    assert executed.factor == 3.0
    assert runtime.seconds > 0


def test_how_many_points_there_are_decides_on_no_graph(runtime: OnnxRuntime) -> None:
    """The same graph serves any number of points, until more points are given than it has room for."""
    module = Spread()
    executed = runtime(module)
    generator = torch.Generator().manual_seed(3)
    for count, exported in ((5, 1), (40, 1), (256, 1), (2, 1), (257, 2)):
        points = torch.rand(3, count, 2, generator=generator)
        points[1, 0] = torch.nan
        pair = Pair(torch.rand(3, 4, count, generator=generator), None)
        (off, mean, through), (ours, own, passed) = module(points, pair), executed(points, pair)
        torch.testing.assert_close(ours, off, equal_nan=True)
        torch.testing.assert_close(own, mean)
        torch.testing.assert_close(passed.second, through.second, equal_nan=True)
        assert torch.equal(passed.first, pair.first)
        assert runtime.exported == exported


def test_what_takes_long_is_said_once(runtime: OnnxRuntime, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fingerflow.export.runtime._PATIENCE", 1e-9)
    executed = runtime(Scaled(3.0))
    with pytest.warns(UserWarning, match="1 graphs have been exported") as said:
        executed(torch.ones(1, 4, 6), Pair(torch.ones(1, 4, 6), None), torch.eye(2, 3)[None])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        executed.largest(torch.ones(1, 4, 6))
    assert str(runtime.folder) in str(said[0].message)


def test_graphs_are_kept_for_the_next_time(runtime: OnnxRuntime) -> None:
    """Graphs are kept by settings, buffers and shapes, and not exported again."""
    frames = torch.ones(1, 4, 6)
    pair, matrix = Pair(frames, None), torch.eye(2, 3)[None]
    runtime(Scaled(3.0))(frames, pair, matrix)
    again = OnnxRuntime(1, runtime.folder)
    torch.testing.assert_close(again(Scaled(3.0))(frames, pair, matrix).first, frames * 4.5)
    assert (again.exported, again.seconds) == (0, 0.0)
    torch.testing.assert_close(again(Scaled(2.0))(frames, pair, matrix).first, frames * 3.5)
    other = Scaled(2.0)
    other.offset += 1
    torch.testing.assert_close(again(other)(frames, pair, matrix).first, frames * 4.5)
    again(Scaled(2.0))(frames[:, :3], Pair(frames[:, :3], None), matrix)
    assert again.exported == 3


def test_a_branch_on_data_is_refused(runtime: OnnxRuntime) -> None:
    with pytest.raises(Exception, match=r"(?i)data-dependent|guard|standard operators"):
        runtime(Branching())(torch.ones(1, 3))
    assert not runtime.folder.exists() or not list(runtime.folder.iterdir())


def test_missing_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(FingerflowError, match=r"onnx, onnxscript, onnxruntime, not installed.*\[export\]"):
        OnnxRuntime(1)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="files have no user here")
@pytest.mark.parametrize("made", ["of another user", "writable for all", "a link", "a file"])
def test_a_folder_that_others_may_fill_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: str) -> None:
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    own = OnnxRuntime(1).folder
    assert own == OnnxRuntime(1).folder
    assert own.stat().st_mode & 0o777 == 0o700
    if made == "of another user":
        user = os.getuid()
        monkeypatch.setattr("os.getuid", lambda: user + 1000)
        own = tmp_path / f"fingerflow-graphs-{user + 1000}"
        own.mkdir()  # the folder belongs to the present user
    elif made == "writable for all":
        own.chmod(0o777)
    elif made == "a link":
        own.rename(tmp_path / "elsewhere")
        own.symlink_to(tmp_path / "elsewhere")
    else:
        own.rmdir()
        own.touch()
    assert OnnxRuntime(1).folder != own
