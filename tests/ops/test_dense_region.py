"""The region that a pattern spans: drawn shapes, the same rounds in float64 by SciPy, and what is refused."""

import math

import numpy as np
import pytest
import scipy.ndimage
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.ops.dense_region import dense_region

pytestmark = pytest.mark.usefixtures("each_form")


def disc(size: int, radius: float, period: float | None = None, angle: float = 0.3) -> Tensor:
    """(1, 1, size, size): a disc in the middle, full or of stripes half a period wide."""
    y, x = torch.meshgrid(*(torch.arange(size, dtype=torch.float64) - size / 2 + 0.25,) * 2, indexing="ij")
    inside = torch.hypot(x, y) < radius
    if period is not None:
        inside &= ((x * math.cos(angle) + y * math.sin(angle)) / period) % 1 < 0.5
    return inside[None, None]


def by_scipy(mask: NDArray[np.bool_], radius: int) -> NDArray[np.bool_]:
    def smooth(values: NDArray[np.bool_]) -> NDArray[np.float64]:
        density = values.astype(np.float64)
        for _ in range(3):
            density = scipy.ndimage.uniform_filter(density, 2 * radius + 1, mode="constant")
        return density

    def share(region: NDArray[np.bool_]) -> float:
        return float(np.clip(mask[region].mean() if region.any() else 0, 0.2, 1))

    density = smooth(mask)
    region = density > 0.25
    for _ in range(2):
        region = density > share(region) / 2
    square = np.ones((3, 3), dtype=bool)
    border = scipy.ndimage.binary_dilation(region, square) & ~scipy.ndimage.binary_erosion(region, square)
    level = np.clip(smooth(region)[border].mean() if border.any() else 0, 0.25, 0.5)
    for _ in range(2):
        region = density > share(region) * level
    parts, _ = scipy.ndimage.label(scipy.ndimage.binary_fill_holes(region), square)
    return np.asarray((parts == 1 + np.argmax(np.bincount(parts.flat)[1:])) if parts.any() else parts > 0)


def test_full_disc_keeps_its_area() -> None:
    """At half of the density alone it would lose 3 %: smoothed, its border curves away from that."""
    full = disc(200, 40)
    assert float(dense_region(full, 8).sum()) / float(full.sum()) == pytest.approx(1, abs=0.005)
    smooth = torch.from_numpy(scipy.ndimage.uniform_filter(full[0, 0].numpy().astype(float), 17, mode="constant"))
    for _ in range(2):
        smooth = torch.from_numpy(scipy.ndimage.uniform_filter(smooth.numpy(), 17, mode="constant"))
    assert float((smooth > 0.5).sum()) / float(full.sum()) < 0.97


def test_spans_stripes_and_their_gaps() -> None:
    areas = [float(dense_region(disc(260, 100, 14, angle), 8).sum()) for angle in np.arange(6) / 4]
    assert np.mean(areas) == pytest.approx(math.pi * 100**2, rel=0.004)
    assert np.ptp(areas) / np.mean(areas) < 0.03


@pytest.mark.parametrize("radius", [2, 5, 8, 17, 20])
@pytest.mark.parametrize("kind", ["stripes", "noise", "corner"])
def test_same_rounds_in_float64(kind: str, radius: int) -> None:
    if kind == "stripes":
        mask = disc(150, 50, 1.7 * radius)
    elif kind == "noise":
        share = torch.linspace(0, 0.9, 131) ** 2
        mask = torch.rand(1, 1, 97, 131, generator=torch.Generator().manual_seed(radius)) < share
    else:
        mask = disc(160, 60)[..., 70:, 75:]
    expected = torch.from_numpy(by_scipy(mask[0, 0].numpy(), radius))
    assert expected.any()
    assert int((dense_region(mask, radius)[0, 0] != expected).sum()) <= 1


def test_largest_part_without_holes() -> None:
    mask = torch.zeros(1, 1, 160, 240, dtype=torch.bool)
    mask[..., 20:60, 20:60] = True
    mask[..., 30:140, 100:220] = True
    mask[..., 70:100, 140:180] = False
    region = dense_region(mask, 4)[0, 0]
    assert not region[:, :90].any()
    assert region[70:100, 140:180].all()
    assert float(region.sum()) == pytest.approx(110 * 120, rel=0.02)


@pytest.mark.parametrize("shape", [(0, 4, 5), (2, 0, 5), (1, 1, 1), (3, 1, 60), (1, 50, 1), (2, 13, 17)])
def test_empty_full_and_small_frames(shape: tuple[int, int, int]) -> None:
    batch, height, width = shape
    empty = torch.zeros(batch, 1, height, width, dtype=torch.bool)
    assert not dense_region(empty, 8).any()
    assert dense_region(~empty, 3).shape == empty.shape


def test_frames_do_not_know_each_other() -> None:
    masks = torch.cat([disc(100, radius, 9) for radius in (10, 30, 45)])
    together = dense_region(masks, 5)
    for k in range(3):
        assert torch.equal(together[k : k + 1], dense_region(masks[k : k + 1], 5))


def test_refuses_what_does_not_fit() -> None:
    mask = torch.zeros(1, 1, 8, 8, dtype=torch.bool)
    with pytest.raises(TypeError, match="uint8"):
        dense_region(mask.byte(), 3)
    with pytest.raises(ValueError, match="shape"):
        dense_region(mask[0], 3)
    for radius in (0, 256):
        with pytest.raises(ValueError, match=f"radius of {radius} px"):
            dense_region(mask, radius)
