"""The compiled windows of cubic convolution beside the portable ones."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.tracking import window_correlation
from fingerflow.ops.tracking.window_correlation import sample_windows

Portable = Callable[[Callable[[], Tensor]], Tensor]
NUMBER, WINDOW = 60, 25


def given(dtype: torch.dtype) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Two frames of waves, places all over them and beyond, one of them NaN, and deformations."""
    y, x = torch.meshgrid(torch.arange(90.0), torch.arange(120.0), indexing="ij")
    wave = 120 + 60 * torch.sin(0.5 * x + 0.2 * y) + 40 * torch.cos(0.3 * y - 0.1 * x)
    images = torch.stack((wave, wave.flip(1)))[:, None].round().to(dtype)
    random = torch.rand(NUMBER, 6, generator=torch.Generator().manual_seed(1))
    places = random[:, :2] * torch.tensor([119.0, 89.0])
    places[0, 0] = torch.nan
    warp = torch.eye(2) + 0.3 * (random[:, 2:].unflatten(1, (2, 2)) - 0.5)
    places[1], places[2] = torch.tensor([13.0, 13.0]), torch.tensor([106.0, 76.0])  # on the border that is left
    warp[1:3] = torch.eye(2)
    return images, torch.arange(NUMBER) % 2, places, warp


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16, torch.float32])
@pytest.mark.parametrize("step", [3, 5])
def test_same_windows(dtype: torch.dtype, step: int, instruction_set: int, portable: Portable) -> None:
    """To what rounding of a place, 1e-5 px, is on slopes of 50 grey levels a px."""
    images, number, places, warp = given(dtype)
    found = sample_windows(images, number, places, warp, WINDOW, step)
    exact = (images, number, places.double(), warp.double(), WINDOW, step)
    expected = portable(lambda: sample_windows(*exact))
    assert expected.isfinite().all(1).sum() > NUMBER / 4
    assert found[0].isnan().all()
    assert found[1:3].isfinite().all()
    torch.testing.assert_close(found.double(), expected, rtol=0, atol=2e-3, equal_nan=True)


def test_it_serves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise the portable form would be compared with itself."""
    if not kernels.serve():
        pytest.skip("the compiled kernels were not built or are turned off")
    monkeypatch.setattr(window_correlation, "taken", None)
    sample_windows(*given(torch.uint8), WINDOW, 3)


def test_wrong_shapes_are_named() -> None:
    if not kernels.serve():
        pytest.skip("the compiled kernels were not built or are turned off")
    images, number, places, warp = given(torch.uint8)
    for arguments, message in (
        ((images, number + 1, places, warp, WINDOW, 3), "image_index"),
        ((images, number, places.double(), warp, WINDOW, 3), "places"),
        ((images, number, places, warp[:3], WINDOW, 3), "warp"),
        ((images[..., :3], number, places, warp, WINDOW, 3), "windows of 25 px"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            kernels.sample_windows(*arguments)
