"""Tests of the compiled tracker against the portable one."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from fingerflow.engines.engine import Engine, EngineSettings, Followed
from fingerflow.engines.native import NativeEngine
from fingerflow.engines.torch import TorchEngine
from fingerflow.kernels import tensors as kernels
from fingerflow.ops.tracking.templates import find_templates, prepare_templates
from fingerflow.ops.tracking.track_points import Tracks, TrackStatus, track_points
from tests.kernels.twins import points_inside, skin_of_bytes

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

# Float32 positions of a few hundred px have steps of 3e-5 px; sums are in another order.
TOLERANCE_PX = 1e-4


def same(found: Tracks, expected: Tracks) -> None:
    tracked = expected.status == TrackStatus.TRACKED
    assert torch.equal(found.status == TrackStatus.TRACKED, tracked)
    assert (found.points[tracked] - expected.points[tracked]).abs().max() < TOLERANCE_PX
    assert (found.error[tracked] - expected.error[tracked]).abs().max() < TOLERANCE_PX
    # The residual is a difference of sums of squares a hundred times as large, so that float32 leaves some percent.
    torch.testing.assert_close(found.covariance[tracked], expected.covariance[tracked], rtol=2e-2, atol=2e-6)
    assert found.points[~tracked].isnan().all()
    assert found.covariance[~tracked].isnan().all()


def test_the_order_of_points_and_threads_do_not_matter(torch_threads: Callable[[int], None]) -> None:
    images, points = (skin_of_bytes((0, 0)), skin_of_bytes((0.6, -0.3), 1)), points_inside()
    torch_threads(1)
    alone = track_points(*images, points)
    torch_threads(4)
    shared = track_points(*images, points.flip(1))
    assert torch.equal(alone.points, shared.points.flip(1))
    assert torch.equal(alone.status, shared.status.flip(1))


def test_followed_in_one_call_as_one_after_the_other() -> None:
    """Both forms track eight frames in one call alike, while the skin speeds up and some points are hidden in three
    frames.
    """
    frames = torch.cat([skin_of_bytes((0.05 * k * k, -0.1 * k), k) for k in range(9)])
    frames[4:7, :, 60:110, 90:150] = 128
    points, settings = points_inside()[0].numpy(), EngineSettings(window_px=21, gain_offset=False)

    def followed(engine: Engine) -> Followed:
        images = engine.images(frames[:, 0].numpy())
        return engine.follow(engine.prepare(engine.key(images[:1]), points), images[1:], points, np.zeros_like(points))

    found = followed(NativeEngine(settings))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kernels, "serve", lambda *_: False)
        expected = followed(TorchEngine(settings, torch.device("cpu")))
    same(*(Tracks(*map(torch.from_numpy, one.found[:4])) for one in (found, expected)))
    assert (expected.found.status[4] != TrackStatus.TRACKED).any()
    assert (expected.found.status[7] == TrackStatus.TRACKED).mean() > 0.9
    for one, other in zip(*((one.place, one.speed, one.found.estimate) for one in (found, expected)), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=2e-4)


def test_compiled_templates_agree_with_the_portable_form() -> None:
    image, points = skin_of_bytes((0, 0)), points_inside(count=20)
    points[0, 3] = torch.nan
    warp = torch.tensor([[1.05, 0.02], [-0.03, 0.97]]).expand(1, 20, 2, 2)
    for deformation in (None, warp):
        for free in (False, True):
            found = prepare_templates(image, points, 15, deformation, gain_offset=free)
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(kernels, "serve", lambda *_: False)
                expected = prepare_templates(image, points, 15, deformation, gain_offset=free)
            known = [k for k in range(20) if k != 3]
            for one, other in zip(found[1:4], expected[1:4], strict=True):
                scale = other[:, known].abs().amax((0, 1))
                assert ((one - other)[:, known].abs() <= 2e-4 * scale + 0.02).all()
            assert found.start[0, 3].isnan().all()


def test_compiled_templates_are_found_portably() -> None:
    """Templates prepared by the compiled form are found by the portable one, as when a graph is traced after its
    preparation, or runs on tensors without memory.
    """
    frames = skin_of_bytes((0, 0)), skin_of_bytes((0.6, -0.3), 1)
    kept = prepare_templates(frames[0], points_inside())
    expected = find_templates(kept, frames[1], points_inside())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kernels, "serve", lambda *_: False)
        found = find_templates(kept, frames[1], points_inside())
    same(Tracks(*found[:4]), Tracks(*expected[:4]))
    without_memory = find_templates(
        kept._make(one.to("meta") for one in kept),
        frames[1].to("meta"),
        points_inside().to("meta"),
        rounds=1,
    )
    assert without_memory.points.shape == expected.points.shape
