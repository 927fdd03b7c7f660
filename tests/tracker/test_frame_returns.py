"""Frames that cannot be, and motion and light that can: each drawn, with noise, and nothing else in the way."""

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from fingerflow.synthetic.waves import add_waves, plane_waves
from fingerflow.tracker.block_means import block_means
from fingerflow.tracker.frame_distances import LONGEST, block_distances
from fingerflow.tracker.frame_returns import jumps_and_returns, repeats
from tests.small_trials import SPOILED

FRAMES, HEIGHT, WIDTH = 80, 96, 120
PLACES = (7, 30, 31, 32)
Frames = NDArray[np.float64]


@pytest.fixture(scope="module")
def skin() -> Frames:
    """Texture that moves on by 0.15 px a frame under light from one side, with noise of two grey levels, (F, H, W)."""
    generator = torch.Generator().manual_seed(3)
    waves = plane_waves([9.0, 11.0, 14.0], generator)
    y, x = torch.meshgrid(torch.arange(HEIGHT * 1.0), torch.arange(WIDTH * 1.0), indexing="ij")
    drawn = [add_waves(torch.full_like(x, 120), waves, 30.0, x - 0.15 * k, y) for k in range(FRAMES)]
    noise = 2 * torch.randn(FRAMES, HEIGHT, WIDTH, generator=generator)
    shade = 0.4 + 0.8 * torch.exp(-(((x - 70) / 40) ** 2) - ((y - 40) / 30) ** 2)
    return (torch.stack(drawn) * shade + noise).double().numpy()


def distances(frames: Frames, size: int = 8) -> NDArray[np.float32]:
    """As a stage has them, `size` frames at a time."""
    blocks = block_means(frames).blocks
    parts = [
        block_distances(blocks[k : k + size], blocks[max(k - LONGEST - 1, 0) : k]) for k in range(0, len(blocks), size)
    ]
    return np.concatenate(parts)


def found(frames: Frames, usable: NDArray[np.bool_] | None = None) -> list[int]:
    all_usable = np.ones(len(frames), dtype=bool)
    return np.flatnonzero(jumps_and_returns(distances(frames), all_usable if usable is None else usable)).tolist()


def test_distances_are_those_of_the_definition(skin: Frames) -> None:
    """Row 3 of the 4 x 5 blocks, two frames apart, and the light; batches of any size give the same."""
    got = distances(skin)
    blocks = skin.reshape(FRAMES, 4, HEIGHT // 4, 5, WIDTH // 5).mean((2, 4))
    even = blocks / blocks.mean((1, 2), keepdims=True)
    # Single precision, of differences of some thousandths of the mean.
    assert got[20, 1, 3] == pytest.approx(np.abs(even[20, 3] - even[18, 3]).mean() / 3e-3, rel=3e-4)
    light = np.abs(np.log(skin[20].mean() / skin[18].mean())) / 0.055
    assert got[20, 1, -1] == pytest.approx(light, abs=1e-5)
    assert np.isnan(got[1, 1]).all()
    assert np.isfinite(got[2, 1]).all()
    np.testing.assert_allclose(distances(skin, 1), got, rtol=1e-4, atol=1e-4)


KINDS = {
    **{kind: spoil for kind, (spoil, status) in SPOILED.items() if status == "jumps_and_returns"},
    "foreign": lambda frame: frame[::-1, ::-1],
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("places", [PLACES, (0,), (FRAMES - 1,), (9, 11, 13), (20, 21)])
def test_what_jumps_and_returns_is_found_and_nothing_else(skin: Frames, kind: str, places: tuple[int, ...]) -> None:
    frames = skin.copy()
    for k in places:
        frames[k] = KINDS[kind](frames[k])
    assert found(frames) == list(places)


def test_motion_and_light_that_stay_are_none(skin: Frames) -> None:
    jump = skin.copy()
    jump[30:] = np.roll(jump[30:], 6, 2)
    lamp = skin.copy()
    lamp[30:] *= 0.6
    for frames in (skin, jump, lamp, skin[::10], skin[:1], skin[:3], np.repeat(skin[:1], 20, 0)):
        assert found(frames) == []


@pytest.mark.parametrize("period", [2.1, 2.618, 3.0, 3.3, 7.0])
@pytest.mark.parametrize("share", [0.05, 0.2])
def test_a_lamp_that_flickers_is_none(skin: Frames, period: float, share: float) -> None:
    light = 1 + share * np.sin(2 * np.pi * np.arange(FRAMES) / period)
    assert found(skin * light[:, None, None]) == []


@pytest.mark.parametrize("period", [2, 3, 4, 6, 8, 12])
def test_skin_that_vibrates_is_none(skin: Frames, period: int) -> None:
    shift = np.round(4 * np.sin(2 * np.pi * np.arange(FRAMES) / period + 0.3)).astype(int)
    assert found(np.stack([np.roll(frame, k, 1) for frame, k in zip(skin, shift, strict=True)])) == []


def test_frames_that_are_known_not_to_be_pictures_measure_none(skin: Frames) -> None:
    """Between two black frames a good one is far from both, which agree."""
    frames = skin.copy()
    frames[[20, 22]] = 1 + 0.1 * frames[[20, 22]]
    usable = np.ones(FRAMES, dtype=bool)
    usable[[20, 22]] = False
    assert found(frames, usable) == []
    frames[40] = KINDS["rolled"](frames[40])
    assert found(frames, usable) == [40]


def test_a_copy_of_the_frame_before_is_found(skin: Frames) -> None:
    frames = skin.copy()
    for k in (5, 30, FRAMES - 1):
        frames[k] = frames[k - 1]
    assert np.flatnonzero(repeats(distances(frames))).tolist() == [5, 30, FRAMES - 1]
    still = np.repeat(skin[:1], 20, 0)  # without noise, at rest: no frame is left to repeat
    assert repeats(distances(still))[1:-1].sum() == 0
