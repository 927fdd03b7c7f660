"""Compiled histogram and Otsu's threshold: the portable form bit for bit, NumPy and OpenCV."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
import torch
from kernel_images import CONTENTS, SHAPES, images

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.contact.otsu import histogram, otsu_threshold

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], object]], object]
RANGES = {
    torch.uint8: [(256, None), (256, (-1.0, 255.0)), (256, (9.0, 265.0)), (16, (0.0, 255.0)), (100, (10.5, 200.0))],
    torch.uint16: [(65536, (-1.0, 65535.0)), (4096, (-1.0, 4095.0)), (256, (-1.0, 4095.0)), (50, (100.5, 60000.0))],
}


@pytest.mark.parametrize("dtype", RANGES)
@pytest.mark.parametrize("shape", SHAPES)
def test_same_counts(portable: Portable, shape: tuple[int, int, int], dtype: torch.dtype) -> None:
    frames = images(shape, dtype, "random")
    mask = images(shape, torch.uint8, "random") > 100
    for bins, value_range in RANGES[dtype]:
        for some in (None, mask, mask[:1]):
            counts = histogram(frames, some, bins, value_range)
            assert torch.equal(counts, portable(lambda b=bins, r=value_range, s=some: histogram(frames, s, b, r)))


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("content", CONTENTS)
def test_counts_equal_numpy(content: str, threads: int, torch_threads: Callable[[int], None]) -> None:
    frames = images((3, 120, 77), torch.uint8, content)
    torch_threads(threads)
    counts = histogram(frames)
    assert counts.tolist() == [np.bincount(frame.numpy().ravel(), minlength=256).tolist() for frame in frames]


def test_views_and_masks_of_any_stride(portable: Portable) -> None:
    frames = images((4, 60, 80), torch.uint16, "random", highest=4095)
    mask = frames.to(torch.int32) % 3 > 0
    for part in (np.s_[::2, :, 5:50, 10:70], np.s_[..., ::2], np.s_[:, :, :, :1]):
        counts = histogram(frames[part], mask[part], 4096, (-1, 4095))
        assert torch.equal(counts, portable(lambda p=part: histogram(frames[p], mask[p], 4096, (-1, 4095))))
        assert counts.sum() == mask[part].sum()


@pytest.mark.parametrize("content", CONTENTS)
@pytest.mark.parametrize("shape", SHAPES)
def test_same_threshold(portable: Portable, shape: tuple[int, int, int], content: str) -> None:
    frames = images(shape, torch.uint8, content)
    mask = images(shape, torch.uint8, "random", seed=1) > 60
    for some in (None, mask, torch.zeros_like(mask)):
        threshold = otsu_threshold(frames, some)
        expected = portable(lambda s=some: otsu_threshold(frames, s))
        assert threshold.dtype == expected.dtype
        assert torch.equal(threshold.nan_to_num(-1), expected.nan_to_num(-1))


@pytest.mark.parametrize(("dtype", "value_range"), [(torch.uint16, (-1.0, 4095.0)), (torch.uint8, (20.0, 190.5))])
def test_same_threshold_in_wider_bins(portable: Portable, dtype: torch.dtype, value_range: tuple[float, float]) -> None:
    frames = images((4, 50, 60), dtype, "random", highest=int(value_range[1]))
    threshold = otsu_threshold(frames, None, value_range)
    assert torch.equal(threshold, portable(lambda: otsu_threshold(frames, None, value_range)))


def test_threshold_equals_opencv() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        bright = rng.random((60, 90)) < rng.uniform(0.1, 0.9)
        noise = rng.normal(0, rng.uniform(8, 40), bright.shape)
        frame = np.clip(np.where(bright, 190, 70) + noise, 0, 255).astype(np.uint8)
        expected = cv2.threshold(frame, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)[0]
        assert otsu_threshold(torch.from_numpy(frame)[None, None]).item() == expected


def test_refuses_what_does_not_fit() -> None:
    frames = torch.zeros(2, 1, 8, 8, dtype=torch.uint8)
    with pytest.raises(TypeError, match="int32"):
        kernels.histogram(frames.int(), None, None, 256)
    with pytest.raises(ValueError, match="10 bins for 256 levels"):
        kernels.histogram(frames, None, None, 10)
    with pytest.raises(ValueError, match="a mask of"):
        kernels.histogram(frames, torch.ones(3, 1, 8, 8, dtype=torch.bool), None, 256)
    with pytest.raises(ValueError, match="goes up to 17"):
        kernels.histogram(frames, None, torch.arange(256).div(15, rounding_mode="floor").to(torch.uint16), 16)
    with pytest.raises(ValueError, match="counts is"):
        kernels.otsu_threshold(torch.zeros(1, 255, dtype=torch.int64), -1.0, 255.0)
