"""The compiled tracker beside the portable one."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from fingerflow.engines.engine import Engine, EngineSettings, Followed
from fingerflow.engines.native import NativeEngine
from fingerflow.engines.torch import TorchEngine
from fingerflow.kernels import tensors as kernels
from fingerflow.ops.tracking import templates
from fingerflow.ops.tracking.templates import find_templates, prepare_templates
from fingerflow.ops.tracking.track_points import Tracks, TrackStatus, track_points
from fingerflow.synthetic import RidgeTexture

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

# Positions of a few hundred px in float32 are 3e-5 px apart; sums run in another order.
TOLERANCE_PX = 1e-4


def skin(
    shift: tuple[float, float],
    noise: float = 2.0,
    seed: int = 0,
    size: tuple[int, int] = (150, 190),
    deformation: Tensor | None = None,
) -> Tensor:
    """Ridges moved by a shift, 8 bit, (1, 1, H, W); a deformation about the middle leads to the ones not deformed."""
    y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in size), indexing="ij")
    if deformation is not None:
        middle = torch.tensor([size[1] / 2, size[0] / 2])
        x, y = ((torch.stack((x, y), -1) - middle) @ deformation.double().T + middle).unbind(-1)
    scale = 0.0325
    light = RidgeTexture()((x - shift[0]) * scale, (y - shift[1]) * scale)
    grey = 110 + 80 * light + noise * torch.randn(size, generator=torch.Generator().manual_seed(seed))
    return grey.round().clamp(0, 255).to(torch.uint8)[None, None]


def starts(batch: int = 1, count: int = 60, fraction: bool = True) -> Tensor:
    random = torch.rand(batch, count, 2, generator=torch.Generator().manual_seed(3))
    points = random * torch.tensor([190.0 - 60, 150.0 - 60]) + 30
    return points if fraction else points.round()


def portable(*arguments: object, **settings: object) -> Tracks:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kernels, "serve", lambda *_: False)
        return track_points(*arguments, **settings)  # type: ignore[arg-type]


def same(found: Tracks, expected: Tracks) -> None:
    tracked = expected.status == TrackStatus.TRACKED
    assert torch.equal(found.status == TrackStatus.TRACKED, tracked)
    assert (found.points[tracked] - expected.points[tracked]).abs().max() < TOLERANCE_PX
    assert (found.error[tracked] - expected.error[tracked]).abs().max() < TOLERANCE_PX
    # The residual is a difference of sums of squares, a hundredth of them and less: float32 leaves some percent of it.
    torch.testing.assert_close(found.covariance[tracked], expected.covariance[tracked], rtol=2e-2, atol=2e-6)
    assert found.points[~tracked].isnan().all()
    assert found.covariance[~tracked].isnan().all()


@pytest.fixture(params=[0, 1, 2], ids=["baseline", "avx2", "avx512"])
def instruction_set(request: pytest.FixtureRequest) -> Iterator[int]:
    if kernels.limit_instruction_set(request.param) != request.param:
        kernels.limit_instruction_set(-1)
        pytest.skip("this processor has no such instruction set")
    yield int(request.param)
    kernels.limit_instruction_set(-1)


@pytest.mark.parametrize("gain_offset", [False, True])
@pytest.mark.parametrize("window", [5, 15, 17, 21, 31, 33, 47])
def test_same_tracks(window: int, gain_offset: bool, instruction_set: int) -> None:
    found = track_points(skin((0, 0)), skin((0.6, -0.3), seed=1), starts(), window, gain_offset=gain_offset)
    expected = portable(skin((0, 0)), skin((0.6, -0.3), seed=1), starts(), window, gain_offset=gain_offset)
    assert (expected.status == TrackStatus.TRACKED).float().mean() > (0.5 if window == 5 else 0.9)
    same(found, expected)


def test_it_serves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise every test here would compare the portable form with itself."""
    monkeypatch.setattr(templates, "_step", None)
    track_points(skin((0, 0)), skin((0.6, -0.3)), starts())


@pytest.mark.parametrize("fraction", [False, True])
@pytest.mark.parametrize("motion", [(0.0, 0.0), (0.95, 0.95), (2.5, -1.8)])
def test_motions_and_starts(motion: tuple[float, float], fraction: bool) -> None:
    images = skin((0, 0)), skin(motion, seed=1)
    same(track_points(*images, starts(fraction=fraction)), portable(*images, starts(fraction=fraction)))


@pytest.mark.parametrize("far", [0.0, 0.7])
def test_warp_and_prediction(far: float, instruction_set: int) -> None:
    points = starts()
    warp = torch.tensor([[1.05, 0.02], [-0.03, 0.97]]).expand(1, points.shape[1], 2, 2)
    guess = points + torch.tensor([0.6 + far, -0.3])
    settings = {"initial": guess, "warp": warp, "mismatch_limit": 0.5}
    images = skin((0, 0)), skin((0.6, -0.3), seed=1)
    same(track_points(*images, points, **settings), portable(*images, points, **settings))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "matrix",
    [
        [[1.0, 0.0], [0.066, 1.0]],  # a vector of samples needs taps of five rows, or of six
        [[1.0, 0.0], [0.07, 1.0]],
        [[1.0, 0.01], [-0.066, 1.0]],
        [[1.6, 0.0], [0.0, 0.7]],
        [[0.6, 0.2], [0.1, 1.5]],
        [[-1.0, 0.05], [0.02, 1.0]],  # mirrored
        [[0.0, -1.0], [1.0, 0.0]],  # a quarter turn
    ],
)
@pytest.mark.parametrize("window", [9, 21])
def test_any_warp(matrix: list[list[float]], window: int, instruction_set: int) -> None:
    """An image deformed by F about its middle, points on either side of it, found 0.3 px from where F leads."""
    deformation, middle = torch.tensor(matrix), torch.tensor([95.0, 75.0])
    points = middle + torch.tensor([[[0.3, -0.2], [9.0, 4.5], [-8.2, 6.0], [3.4, -10.0], [-90.0, -70.0]]])
    guess = middle + (points - middle) @ deformation.T + torch.tensor([0.2, -0.2])
    settings: dict[str, Any] = {"initial": guess, "warp": deformation.expand(1, 5, 2, 2), "window": window}
    images = skin((0, 0), deformation=deformation), skin((0, 0), seed=1)
    found, expected = track_points(*images, points, **settings), portable(*images, points, **settings)
    assert (expected.status[0, :4] == TrackStatus.TRACKED).all()
    same(found, expected)


@pytest.mark.parametrize("warped", [False, True])
@pytest.mark.parametrize("gain", [0.45, 2.1])
def test_contrast_that_changes(gain: float, warped: bool) -> None:
    """Steps by the template's structure are 1 / gain too long: Newton's are not."""
    first, second = skin((0, 0)), skin((0.3, -0.2), seed=1).float()
    images = first.float(), gain * second
    warp = torch.eye(2).expand(1, 60, 2, 2) if warped else None
    given: dict[str, Any] = {"gain_offset": True, "warp": warp}
    found, expected = track_points(*images, starts(), **given), portable(*images, starts(), **given)
    assert (expected.status == TrackStatus.TRACKED).float().mean() > 0.9
    same(found, expected)


def test_motion_of_several_tables() -> None:
    images = skin((0, 0)), skin((4.4, -1.2), seed=1)
    found, expected = track_points(*images, starts()), portable(*images, starts())
    assert (expected.status == TrackStatus.TRACKED).float().mean() > 0.5
    same(found, expected)


def test_search_with_a_warp() -> None:
    """The backward check of a searched point begins where its own search ended."""
    images, points = (skin((0, 0)), skin((9.3, -6.6), seed=1)), starts()
    warp = torch.tensor([[1.01, 0.01], [-0.01, 0.99]]).expand(1, points.shape[1], 2, 2)
    found = track_points(*images, points, warp=warp, search=12)
    expected = portable(*images, points, warp=warp, search=12)
    assert (expected.status == TrackStatus.TRACKED).float().mean() > 0.8
    same(found, expected)


def test_search() -> None:
    images = skin((0, 0)), skin((9.3, -6.6), seed=1)
    found, expected = track_points(*images, starts(), search=12), portable(*images, starts(), search=12)
    assert (expected.status == TrackStatus.TRACKED).float().mean() > 0.8
    same(found, expected)


def test_batch() -> None:
    images = torch.cat([skin((0, 0), seed=k) for k in range(3)]), torch.cat([skin((0.2 * k, 0.1)) for k in range(3)])
    same(track_points(*images, starts(3)), portable(*images, starts(3)))
    nothing = track_points(images[0][:0], images[1][:0], starts(3)[:0])
    assert nothing.points.shape == (0, 60, 2)
    assert track_points(*images, starts(3)[:, :0]).status.shape == (3, 0)


def test_the_order_of_points_and_threads_do_not_matter(torch_threads: Callable[[int], None]) -> None:
    images, points = (skin((0, 0)), skin((0.6, -0.3), seed=1)), starts()
    torch_threads(1)
    alone = track_points(*images, points)
    torch_threads(4)
    shared = track_points(*images, points.flip(1))
    assert torch.equal(alone.points, shared.points.flip(1))
    assert torch.equal(alone.status, shared.status.flip(1))


def test_points_that_cannot_be_tracked() -> None:
    """The reasons are the same; beyond them, far outside or with bad numbers, nothing is read that is not there."""
    bad = torch.tensor(
        [[torch.nan, 5.0], [torch.inf, 5.0], [-300.0, 20.0], [1e9, 1e9], [-3e38, 3e38], [3.0, 3.0], [188.0, 148.0]]
    )[None]
    images = skin((0, 0)), skin((0.6, -0.3), seed=1)
    found, expected = track_points(*images, bad), portable(*images, bad)
    assert torch.equal(found.status, expected.status)
    assert found.points.isnan().all()
    guess = starts(count=7) + bad.nan_to_num(0.0, 1e30, -1e30)
    same(track_points(*images, starts(count=7), initial=guess), portable(*images, starts(count=7), initial=guess))


@pytest.mark.parametrize("matrix", [[[0.0, 0.0], [0.0, 0.0]], [[1.0, 1.0], [1.0, 1.0]], [[torch.nan, 0.0], [0.0, 1.0]]])
def test_a_warp_that_is_none(matrix: list[list[float]]) -> None:
    images = skin((0, 0)), skin((0.6, -0.3), seed=1)
    warp = torch.tensor(matrix).expand(1, 60, 2, 2)
    for tracks in (track_points(*images, starts(), warp=warp), portable(*images, starts(), warp=warp)):
        assert (tracks.status == TrackStatus.NOT_FINITE).all()


@pytest.mark.parametrize("level", [0.0, 128.0, 255.0])
def test_blank_frames(level: float) -> None:
    blank = torch.full((1, 1, 80, 90), level).to(torch.uint8)
    points = torch.tensor([[[40.0, 40.0], [45.5, 30.2]]])
    assert (track_points(blank, blank, points).status == TrackStatus.NO_TEXTURE).all()


def test_bad_pixels_spoil_only_the_windows_that_hold_them() -> None:
    first, second = skin((0, 0)).float(), skin((0.6, -0.3), seed=1).float()
    first[..., 60, 70], second[..., 100, 120] = torch.nan, torch.inf
    points = starts()
    found, expected = track_points(first, second, points), portable(first, second, points)
    assert torch.equal(found.status == TrackStatus.NOT_FINITE, expected.status == TrackStatus.NOT_FINITE)
    assert (found.status == TrackStatus.NOT_FINITE).any()
    same(found, expected)


def test_frames_that_are_not_contiguous() -> None:
    wide = torch.cat([skin((0, 0)), skin((0.6, -0.3), seed=1)], dim=3)
    images = wide[..., :190], wide[..., 190:]
    points = starts().flip(-1).flip(-1)[:, ::2]
    same(track_points(*images, points), portable(*[image.clone() for image in images], points.clone()))


@pytest.mark.parametrize("dtype", [torch.float64, torch.int32, torch.uint8, torch.float32])
def test_other_number_types(dtype: torch.dtype) -> None:
    images = [skin((0, 0)).to(dtype), skin((0.6, -0.3), seed=1).to(dtype)]
    same(track_points(*images, starts()), portable(*images, starts()))


def test_what_needs_a_derivative_is_portable() -> None:
    image = skin((0, 0)).float().requires_grad_()
    tracks = track_points(image, skin((0.6, -0.3), seed=1).float(), starts())
    tracks.points.nansum().backward()
    assert image.grad is not None
    assert image.grad.abs().sum() > 0


def test_followed_in_one_call_as_one_after_the_other() -> None:
    """Eight frames in which a point speeds up, and one that cannot be seen in three of them."""
    frames = torch.cat([skin((0.05 * k * k, -0.1 * k), seed=k) for k in range(9)])
    frames[4:7, :, 60:110, 90:150] = 128
    points, settings = starts()[0].numpy(), EngineSettings(window_px=21, gain_offset=False)

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


def test_templates_of_either_form() -> None:
    image, points = skin((0, 0)), starts(count=20)
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
    """As when a graph that was prepared eagerly is traced, or runs on tensors without memory."""
    frames = skin((0, 0)), skin((0.6, -0.3), seed=1)
    kept = prepare_templates(frames[0], starts())
    expected = find_templates(kept, frames[1], starts())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kernels, "serve", lambda *_: False)
        found = find_templates(kept, frames[1], starts())
    same(Tracks(*found[:4]), Tracks(*expected[:4]))
    without_memory = find_templates(
        kept._make(one.to("meta") for one in kept),
        frames[1].to("meta"),
        starts().to("meta"),
        rounds=1,
    )
    assert without_memory.points.shape == expected.points.shape
