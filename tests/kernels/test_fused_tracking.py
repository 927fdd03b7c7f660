"""Tests of the fused tracking kernel against the portable form, in Triton's interpreter if there is no CUDA GPU."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from fingerflow.engines.engine import EngineSettings, Followed
from fingerflow.engines.torch import TorchEngine, _TorchTemplates
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.tensors import serving
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.ops.tracking.templates import Found, Templates, find_templates, prepare_templates
from tests.kernels.fused import DEVICE
from tests.replayed_ops import Ops

pytest.importorskip("triton", reason="Triton is not installed: pip install fingerflow-engine[gpu]")


HEIGHT, WIDTH, POINTS, RECORDINGS = 48, 56, 7, 2
# px and grey levels: sums over a window are in another order.
CLOSE = {"rtol": 2e-4, "atol": 2e-5, "equal_nan": True}

Array = np.ndarray[Any, Any]


def skin(shift: float, seed: int, levels: float = 255.0) -> Tensor:
    """Return waves with periods from 6 px on, (H, W) of 0 to `levels`, moved by `shift` along x and half of it
    along y.
    """
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    waves = random.uniform(-1, 1, (30, 3))
    total = sum(np.sin(a * (x - shift) + b * (y - shift / 2) + 9 * c) for a, b, c in waves)
    return torch.from_numpy((0.45 + 0.05 * np.asarray(total)).clip(0, 1) * levels)


def views(shift: float, kind: torch.dtype) -> Tensor:
    """Return frames (B, 1, H, W) of two skins."""
    levels = 255.0 if kind == torch.uint8 else 4000.0
    whole = torch.stack([skin(shift, seed, levels) for seed in range(RECORDINGS)])[:, None]
    return (whole.round() if kind != torch.float32 else whole).to(kind).to(DEVICE)


def points(seed: int = 0) -> Tensor:
    """Return points (B, N, 2) px in the middle, near borders, outside, and NaN."""
    random = torch.Generator().manual_seed(seed)
    found = 16 + torch.tensor([WIDTH - 32.0, HEIGHT - 32.0]) * torch.rand(RECORDINGS, POINTS, 2, generator=random)
    found[0, 1] = torch.tensor([torch.nan, 20.0])
    found[0, 2] = torch.tensor([5.2, 30.0])
    found[1, 3] = torch.tensor([WIDTH - 3.0, HEIGHT - 4.0])
    found[1, 4] = torch.tensor([-300.0, 1e9])
    return found.to(DEVICE)


def agree(ours: Found, theirs: Found, scale: float = 1.0) -> None:
    """Assert that statuses are equal and results agree to rounding."""
    torch.testing.assert_close(ours.status, theirs.status, rtol=0, atol=0)
    for one, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(one, other, **{**CLOSE, "atol": scale * CLOSE["atol"]})


LONG = pytest.mark.long  # the interpreter takes seconds


@pytest.mark.parametrize(
    ("kind", "window", "gain_offset"),
    [
        (torch.uint8, 11, True),
        *(pytest.param(kind, 25, False, marks=LONG) for kind in (torch.uint8, torch.int32, torch.float32)),
        *(pytest.param(kind, 11, True, marks=LONG) for kind in (torch.int32, torch.float32)),
    ],
)
def test_a_frame(kind: torch.dtype, window: int, gain_offset: bool, fused: Callable[[], None]) -> None:
    templates = prepare_templates(views(0, kind), points(), window, gain_offset=gain_offset)
    near = points() + 0.3
    near[1, 5] += 2.0  # further than one step away
    near[1, 6, 0] = torch.nan
    current = views(0.4, kind)
    given = {"noise": torch.tensor([1.0, 3.0], device=DEVICE)} if gain_offset else {}
    expected = find_templates(templates, current, near, **given)
    fused()
    found = find_templates(templates, current, near, **given)
    agree(found, expected)
    said = set(expected.status.flatten().tolist())
    assert {TrackStatus.TRACKED, TrackStatus.NOT_FINITE, TrackStatus.LEFT_FRAME} <= said


@LONG
def test_every_reason(fused: Callable[[], None]) -> None:
    """Both forms give the same status for blank skin, a pixel that is NaN, other skin, inverted contrast, and limits
    that no point keeps.
    """
    before = views(0, torch.float32)
    before[1, 0, :24] = 100.0
    templates = prepare_templates(before, points(), 11)
    other = views(0.2, torch.float32)
    other[0, 0, 20:, 30:] = 4000 - other[0, 0, 20:, 30:]
    other[0, 0, 20, 24] = torch.nan
    other[1] = other[0].nan_to_num().roll(9, 1)
    noise = torch.tensor([1.0, 3000.0], device=DEVICE)  # more than all contrast, so that no mismatch is seen
    for limits in ({}, {"forward_backward_limit": 1e-5}, {"rounds": 1, "mismatch_limit": 1.0}, {"noise": noise}):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(serving, "_is_on_gpu", lambda tensor: False)
            expected = find_templates(templates, other, points(), **limits)
        fused()
        # Residuals of points that match nothing are large.
        agree(find_templates(templates, other, points(), **limits), expected, scale=10)


def test_views_smaller_than_a_patch(fused: Callable[[], None]) -> None:
    """In views smaller than a patch the border is replicated, and both forms find the same."""
    image = views(0, torch.uint8)[:, :, :12, :14]
    near = torch.rand(RECORDINGS, POINTS, 2, device=DEVICE) * 10
    templates = prepare_templates(image, near, 11)
    expected = find_templates(templates, image, near)
    fused()
    agree(find_templates(templates, image, near), expected)


def follow(engine: TorchEngine) -> list[Followed]:
    """Follow seven and five points of two recordings of four and two frames; some points are lost in one frame."""
    frames, start = [[views(0.3 * k, torch.uint8)[b] for k in range(5)] for b in range(RECORDINGS)], points()
    frames[0][2][:, :, : WIDTH // 2] = frames[0][2].flip(1)[:, :, : WIDTH // 2]
    many = []
    for b, (last, count) in enumerate(((4, 7), (2, 5))):
        templates = prepare_templates(frames[b][0][None], start[b : b + 1, :count], 11)
        place = start[b, :count].cpu().numpy()
        speed = np.full_like(place, 0.1)
        many.append(
            (
                _TorchTemplates(templates, templates.numbers[0].cpu().numpy()),
                torch.stack(frames[b][1 : last + 1]),
                place,
                speed,
                None,
            )
        )
    return engine.begun("follow", many)()


@LONG
def test_recordings_of_several_frames(fused: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> None:
    """One launch tracks all recordings, each from its own prediction and to its own last frame."""
    engine = TorchEngine(EngineSettings(window_px=11), DEVICE)
    expected = follow(engine)
    fused()
    monkeypatch.setattr(TorchEngine, "_look", None)  # frames must not be tracked one by one
    for ours, theirs in zip(follow(engine), expected, strict=True):
        np.testing.assert_array_equal(ours.found.status, theirs.found.status)
        known = theirs.found.status == TrackStatus.TRACKED
        for one, other in zip(ours.found, theirs.found, strict=True):
            np.testing.assert_allclose(one[known], other[known], **CLOSE)
        for one, other in ((ours.place, theirs.place), (ours.speed, theirs.speed)):
            np.testing.assert_allclose(one, other, **CLOSE)
    tracked = expected[0].found.status == TrackStatus.TRACKED
    assert (tracked[0] & ~tracked[1] & tracked[2]).any()
    assert (tracked[2] & tracked[3]).any()


def test_fused_tracking_of_no_points_gives_empty_results(fused: Callable[[], None]) -> None:
    fused()
    templates = prepare_templates(views(0, torch.uint8), points(), 11)
    none = Templates(*(one[:, :0] for one in templates))
    found = find_templates(none, views(0, torch.uint8), points()[:, :0])
    assert found.points.shape == (RECORDINGS, 0, 2)


def test_fused_tracking_serves_single_precision_outside_tracing(fused: Callable[[], None]) -> None:
    fused()
    samples = torch.zeros(1, 3, 3, 121)
    assert kernels.fused_tracking_serves(samples)
    assert not kernels.fused_tracking_serves(samples.double())
    assert not kernels.fused_tracking_serves(torch.zeros(1, 3, 3, 59**2))
    with Ops():  # as while a graph is traced or its launches are counted
        assert not kernels.fused_tracking_serves(samples)
