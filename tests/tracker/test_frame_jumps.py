"""Tests of frames that jump and return, and of copies, against motion and changes of light that are real, all drawn
with noise.
"""

import numpy as np
import pytest
import torch

from fingerflow.engines.engine import Array
from fingerflow.kernels.library import is_present
from fingerflow.synthetic.waves import add_waves, plane_waves
from fingerflow.tracker import frame_distances
from fingerflow.tracker.block_means import block_means
from fingerflow.tracker.frame_copies import copies
from fingerflow.tracker.frame_distances import PixelSamples, squared_distances_before
from fingerflow.tracker.frame_jumps import is_jump, jumps_and_returns
from tests.small_trials import SPOILED

FRAMES, HEIGHT, WIDTH = 80, 96, 120


@pytest.fixture(scope="module")
def skin() -> Array:
    """Return frames (F, H, W) of texture that moves by 0.15 px a frame under light from one side, with noise of two
    grey levels.
    """
    generator = torch.Generator().manual_seed(3)
    waves = plane_waves([9.0, 11.0, 14.0], generator)
    y, x = torch.meshgrid(torch.arange(HEIGHT * 1.0), torch.arange(WIDTH * 1.0), indexing="ij")
    drawn = [add_waves(torch.full_like(x, 120), waves, 30.0, x - 0.15 * k, y) for k in range(FRAMES)]
    noise = 2 * torch.randn(FRAMES, HEIGHT, WIDTH, generator=generator)
    shade = 0.4 + 0.8 * torch.exp(-(((x - 70) / 40) ** 2) - ((y - 40) / 30) ** 2)
    return (torch.stack(drawn) * shade + noise).double().numpy()


def distances(frames: Array, size: int = 8) -> Array:
    """Return the distances of frames from earlier ones, computed for `size` frames at a time as a stage does."""
    before, parts = None, []
    for k in range(0, len(frames), size):
        samples = PixelSamples.of(block_means(frames[k : k + size])[2])
        parts.append(squared_distances_before(samples, before))
        before = samples.after(before)
    return np.concatenate(parts)


def found(frames: Array) -> list[int]:
    return np.flatnonzero(jumps_and_returns(distances(frames), np.ones(len(frames), dtype=bool))).tolist()


@pytest.mark.parametrize("compiled", [True, False])
def test_distances_are_those_of_the_definition(skin: Array, compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The distances of band 3 of 8 (12 of 96 lines), of the whole view and of the light, two frames apart, are those of
    the definition, for batches of any size.
    """
    if compiled and not is_present():
        pytest.skip("the compiled library is not there")
    monkeypatch.setattr(frame_distances, "is_present", lambda: compiled)
    got = distances(skin)
    even = skin / skin.mean((1, 2), keepdims=True)
    off = np.minimum(np.abs(even[20] - even[18]), 0.3)
    light = np.log(skin[20].mean() / skin[18].mean())
    expected = [(off[36:48].mean() / 1e-2) ** 2, (off.mean() / 1e-2) ** 2, (light / 0.15) ** 2]
    # Float32, with differences of some hundredths of the mean.
    np.testing.assert_allclose(got[20, 1, [3, 8, 9]], expected, rtol=1e-4, atol=1e-8)
    assert np.isnan(got[1, 1]).all()
    assert np.isfinite(got[2, 1]).all()
    np.testing.assert_allclose(distances(skin, 1), got, rtol=1e-4, atol=1e-4)


KINDS = {
    **{kind: spoil for kind, (spoil, status) in SPOILED.items() if status == "jumps_and_returns"},
    "foreign": lambda frame: frame[::-1, ::-1],
}


@pytest.mark.parametrize("kind", KINDS)
def test_what_jumps_and_returns_is_found_and_nothing_else(skin: Array, kind: str) -> None:
    """Also next to an end of the recording, and where they are more than a tenth of it."""
    last = FRAMES - 1
    for places in ([0, 30, 31, 32], [9, 11, 13], [20, 21, last], [1, 2, 3], [last - 3, last - 2, last - 1], [8, 9, 10]):
        frames = skin[: 24 if places[-1] == 10 else FRAMES].copy()
        for k in places:
            frames[k] = KINDS[kind](frames[k])
        assert found(frames) == places


def test_motion_and_light_that_stay_are_none(skin: Array) -> None:
    jump = skin.copy()
    jump[30:] = np.roll(jump[30:], 6, 2)
    lamp = skin.copy()
    lamp[30:] *= 0.6
    for frames in (skin, jump, lamp, skin[::10], skin[:1], skin[:3], np.repeat(skin[:1], 20, 0)):
        assert found(frames) == []


def test_skin_that_lands_and_swings_back_by_a_little_has_not_returned() -> None:
    """Skin rushes by 7.5 px, stops, and comes `back`; squared distances are those of these ways and noise of 7."""
    noise = np.array([7.0])
    for back, returns in ((1.9, False), (6.0, True)):
        ways = (way**2 + noise for way in (7.5, back, 7.5 - back))
        assert is_jump(*ways, noise, noise, (noise, noise / 28)) == returns


@pytest.mark.parametrize("period", [2.1, 3.0, 3.3, 7.0])
def test_flickering_light_and_vibrating_skin_are_no_return_of_a_frame(skin: Array, period: float) -> None:
    phase = 2 * np.pi * np.arange(FRAMES) / period
    for share in (0.05, 0.2):
        assert found(skin * (1 + share * np.sin(phase))[:, None, None]) == []
    shift = np.round(4 * np.sin(2 * np.pi * np.arange(FRAMES) / round(period) + 0.3)).astype(int)
    assert found(np.stack([np.roll(frame, k, 1) for frame, k in zip(skin, shift, strict=True)])) == []


def test_copies_are_found() -> None:
    """Of frames that repeat the one before the first counts; of equal frames that lie apart none does."""
    keys = [(bytes([k]),) for k in range(FRAMES)]
    keys[30:33], keys[77:80] = [keys[29]] * 3, keys[37:40]
    found = copies(keys, np.ones(FRAMES, dtype=bool))
    assert np.flatnonzero(found).tolist() == [30, 31, 32, 37, 38, 39, 77, 78, 79]
