"""Tests of the compiled tracker against the portable one."""

import numpy as np
import pytest
import torch

from fingerflow.engines.engine import Engine, EngineSettings, Followed
from fingerflow.engines.native import NativeEngine
from fingerflow.engines.torch import TorchEngine
from fingerflow.kernels import tensors as kernels
from fingerflow.ops.tracking.track_points import Tracks, TrackStatus
from tests.kernels.twins import points_inside, skin_of_bytes
from tests.without_kernels import without_kernels

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


def test_followed_in_one_call_as_one_after_the_other() -> None:
    """Both forms track eight frames in one call alike, while the skin speeds up and some points are hidden in three
    frames.
    """
    frames = torch.cat([skin_of_bytes((0.05 * k * k, -0.1 * k), k) for k in range(9)])
    frames[4:7, :, 60:110, 90:150] = 128
    points, settings = points_inside()[0].numpy(), EngineSettings(window_px=21, gain_offset=False)

    def followed(engine: Engine) -> Followed:
        images = engine.images(frames[:, 0].numpy())
        return engine.track(engine.prepare(images[:1], points), images[1:], points, np.zeros_like(points))

    found = followed(NativeEngine(settings))
    with pytest.MonkeyPatch.context() as patch:
        without_kernels(patch)
        expected = followed(TorchEngine(settings, torch.device("cpu")))
    same(*(Tracks(*map(torch.from_numpy, one.found[:4])) for one in (found, expected)))
    assert (expected.found.status[4] != TrackStatus.TRACKED).any()
    assert (expected.found.status[7] == TrackStatus.TRACKED).mean() > 0.9
    for one, other in zip(*((one.place, one.speed, one.found.estimate) for one in (found, expected)), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=2e-4)
