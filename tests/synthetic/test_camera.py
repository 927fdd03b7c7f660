import numpy as np
import pytest
import torch

from fingerflow.schema.views import View
from fingerflow.synthetic import Camera

SHAPE = (400, 500)


@pytest.mark.parametrize(("bit_depth", "light"), [(8, 20.0), (12, 125.5), (16, 200.0)])
def test_noise_has_its_mean_and_variance(bit_depth: int, light: float) -> None:
    camera = Camera(bit_depth=bit_depth)
    clean = camera.expose(torch.full(SHAPE, light))
    frame = camera.read_out(clean, 0)
    assert frame.dtype == (np.uint8 if bit_depth == 8 else np.uint16)
    expected = (light + 2) * (2**bit_depth - 1) / 255
    # Five standard errors of a mean and of a variance of 200 000 draws; rounding adds its 1/12.
    variance = float(camera.variance(clean[0, 0])) + 1 / 12
    assert frame.mean() == pytest.approx(expected, abs=5 * (variance / frame.size) ** 0.5)
    assert frame.astype(float).var() == pytest.approx(variance, rel=5 * (2 / frame.size) ** 0.5)


def test_noise_is_the_stated_deviation_at_half_of_the_range_and_shot_noise_grows_with_light() -> None:
    camera = Camera(noise=3.0, shot_share=0.5)
    half, dark, twice = (float(camera.variance(torch.tensor(level))) for level in (127.5, 2.0, 253.0))
    assert half == pytest.approx(9.0)
    assert dark == pytest.approx(4.5)
    assert twice == pytest.approx(13.5)
    assert float(Camera(noise=3.0, shot_share=0.0).variance(torch.tensor(250.0))) == pytest.approx(9.0)


def test_salt_and_pepper_stay_in_their_view() -> None:
    camera = Camera(salt_and_pepper=0.01)
    frame = camera.read_out(torch.full(SHAPE, 120.0), 0, defects=View(rows=(0, 400), columns=(250, 500)))
    extreme = (frame == 0) | (frame == 255)
    assert not extreme[:, :250].any()
    # 1000 pixels are drawn, some twice: a share of 1 - exp(-0.01) at most; half of them are white.
    assert extreme[:, 250:].mean() == pytest.approx(0.00995, abs=0.0002)
    assert (frame == 255).sum() / extreme.sum() == pytest.approx(0.5, abs=0.08)
