"""The compiled search beside the portable one."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.tracking.search import search_windows
from fingerflow.synthetic import RidgeTexture

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], Tensor]], Tensor]


def skin(shift: tuple[float, float], seed: int, size: tuple[int, int] = (151, 190)) -> Tensor:
    """Ridges moved by a shift, (1, 1, H, W)."""
    y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in size), indexing="ij")
    light = RidgeTexture()((x - shift[0]) * 0.0325, (y - shift[1]) * 0.0325)
    return (110 + 80 * light + torch.randn(size, generator=torch.Generator().manual_seed(seed))).float()[None, None]


def starts(count: int = 40) -> Tensor:
    """Points all over the frame, some with their templates beyond its border."""
    return torch.rand(count, 2, generator=torch.Generator().manual_seed(3)) * torch.tensor([189.0, 150.0])


@pytest.mark.parametrize(("window", "radius"), [(21, 6), (9, 1), (15, 24), (33, 13)])
def test_same_places(window: int, radius: int, instruction_set: int, portable: Portable) -> None:
    images = torch.cat([skin((0, 0), 0), skin((0, 0), 2)]), torch.cat([skin((4.3, -5.2), 1), skin((1.0, 3.0), 3)])
    index = torch.arange(40) % 2
    given = (*images, index, starts(), starts() + 0.3, window, radius)
    found, expected = search_windows(*given), portable(lambda: search_windows(*given))
    assert (found - expected).abs().max() < 1e-2  # a start for the tracker, good to about a pixel


def test_places_and_pixels_that_are_none(portable: Portable) -> None:
    images = skin((0, 0), 0), skin((2.0, 1.0), 1)
    images[0][..., 60:70, 70:90], images[1][..., 100, 120] = torch.nan, torch.inf
    guess = starts()
    guess[0, 0], guess[1, 1], guess[2, 0], guess[3, 1] = torch.nan, torch.inf, 1e30, -1e9
    given = (*images, torch.zeros(40, dtype=torch.int64), starts(), guess, 21, 6)
    found, expected = search_windows(*given), portable(lambda: search_windows(*given))
    near = expected.abs().amax(1) < 1e4
    torch.testing.assert_close(found[near], expected[near], rtol=0, atol=1e-2)
    assert torch.equal(found[0].isnan(), guess[0].isnan())
    assert torch.equal(found[1], guess[1])


def test_blank_images_and_no_points() -> None:
    blank = torch.full((1, 1, 40, 50), 7.0)
    index = torch.zeros(40, dtype=torch.int64)
    assert torch.equal(search_windows(blank, blank, index, starts(), starts() + 1, 21, 6), starts() + 1)
    assert search_windows(blank, blank, index[:0], starts(0), starts(0), 21, 6).shape == (0, 2)


def test_wrong_shapes_are_named() -> None:
    image, index, points = torch.zeros(1, 1, 20, 20), torch.zeros(3, dtype=torch.int64), torch.zeros(3, 2)
    for given, message in (
        ((image, image[..., :9], index, points, points, 31, 3), "images"),
        ((image, image, index + 1, points, points, 31, 3), "image_index"),
        ((image, image, index, points, points.double(), 31, 3), "guess"),
        ((image, image, index, points, points, 30, 3), "30"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            kernels.search_windows(*given)
