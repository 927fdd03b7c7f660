"""The compiled median against the portable one, SciPy and OpenCV, for every instruction set of this processor."""

import functools

import cv2
import numpy as np
import pytest
import scipy.ndimage
import torch
from kernel_images import images

from fingerflow.kernels import tensors as kernels
from fingerflow.ops.filters.median import median_filter

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

SHAPES = [(1, 1), (1, 300), (300, 1), (2, 3), (5, 8), (37, 41), (64, 129), (33, 800), (130, 65)]


def scipy_median(frames: torch.Tensor, size: int) -> torch.Tensor:
    filtered = [scipy.ndimage.median_filter(frame[0], size, mode="nearest") for frame in frames.numpy()]
    return torch.from_numpy(np.stack(filtered))[:, None]


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16])
@pytest.mark.parametrize("size", [3, 5, 7, 9, 11])
@pytest.mark.parametrize("shape", SHAPES)
def test_random_frames_equal_scipy(instruction_set: int, size: int, shape: tuple[int, int], dtype: torch.dtype) -> None:
    frames = images((1, *shape), dtype, "random")
    assert torch.equal(kernels.median(frames, size), scipy_median(frames, size))


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16])
@pytest.mark.parametrize("content", ["constant", "ramp", "two levels", "random"])
@pytest.mark.parametrize("size", [3, 5, 9])
def test_equals_the_portable_form(
    monkeypatch: pytest.MonkeyPatch, instruction_set: int, size: int, content: str, dtype: torch.dtype
) -> None:
    frames = images((2, 61, 94), dtype, content)
    compiled = kernels.median(frames, size)
    monkeypatch.setattr(kernels, "serve", lambda *tensors: False)
    assert torch.equal(compiled, median_filter(frames, size))


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16])
@pytest.mark.parametrize("size", [13, 15, 21, 31])
@pytest.mark.parametrize("shape", [(1, 1), (1, 70), (70, 1), (9, 30), (75, 90), (20, 1300)])
def test_windows_by_table_equal_scipy(
    instruction_set: int, size: int, shape: tuple[int, int], dtype: torch.dtype
) -> None:
    frames = images((1, *shape), dtype, "random")
    assert torch.equal(kernels.median(frames, size), _scipy_median_once(shape, dtype, size))


@functools.cache
def _scipy_median_once(shape: tuple[int, int], dtype: torch.dtype, size: int) -> torch.Tensor:
    return scipy_median(images((1, *shape), dtype, "random"), size)


@pytest.mark.parametrize("size", [17, 19, 23, 25, 27, 29])
def test_every_other_size(size: int) -> None:
    frames = images((1, 40, 50), torch.uint8, "random")
    assert np.array_equal(kernels.median(frames, size)[0, 0], cv2.medianBlur(frames[0, 0].numpy(), size))


@pytest.mark.parametrize("size", [3, 5, 7, 9, 11])
def test_equals_opencv(instruction_set: int, size: int) -> None:
    frame = images((1, 512, 640), torch.uint8, "random")
    assert np.array_equal(kernels.median(frame, size)[0, 0], cv2.medianBlur(frame[0, 0].numpy(), size))


@pytest.mark.parametrize("size", [5, 9])
def test_windows_at_the_edge_of_the_majority(instruction_set: int, size: int) -> None:
    """0/1 frames with about half ones: by the zero-one principle they tell whether a min/max network selects right."""
    generator = np.random.default_rng(size)
    frames = (generator.random((4, 1, 200, 300)) < 0.5).astype(np.uint8)
    frames[2] = scipy.ndimage.median_filter(frames[2, 0], 5)  # runs in place of single pixels
    frames[3, 0] = np.add.outer(np.arange(200) // 4, np.arange(300) // 4) % 2
    kernel = np.ones(size)
    ones = scipy.ndimage.convolve1d(frames.astype(int), kernel, axis=2, mode="nearest")
    ones = scipy.ndimage.convolve1d(ones, kernel, axis=3, mode="nearest")
    assert np.array_equal(kernels.median(torch.from_numpy(frames), size), ones > size * size // 2)


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("batch", [0, 1, 5])
def test_batches_and_threads(batch: int, threads: int) -> None:
    before = torch.get_num_threads()
    frames = images((batch, 150, 90), torch.uint8, "random")
    try:
        torch.set_num_threads(threads)
        together = median_filter(frames, 9)
    finally:
        torch.set_num_threads(before)
    assert together.shape == frames.shape
    assert all(torch.equal(one, scipy_median(frame[None], 9)[0]) for one, frame in zip(together, frames, strict=True))


@pytest.mark.parametrize("dtype", [torch.uint8, torch.uint16])
def test_views_are_read_where_they_are(dtype: torch.dtype) -> None:
    frames = images((4, 80, 120), torch.uint8, "random").to(dtype)
    for view in (frames[::2, :, 7:60, 33:90], frames[..., ::2], frames.mT, frames[:1].expand(3, 1, 80, 120)):
        assert torch.equal(
            kernels.median(view, 5), kernels.median(view.clone(memory_format=torch.contiguous_format), 5)
        )


def test_callers_in_many_threads_get_their_own_answer() -> None:
    from concurrent.futures import ThreadPoolExecutor

    frames = images((8, 120, 200), torch.uint8, "random")
    expected = scipy_median(frames, 9)
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            found = list(pool.map(lambda frame: kernels.median(frame[None], 9), frames))
            assert torch.equal(torch.cat(found), expected)


def test_refuses_what_it_was_not_made_for() -> None:
    frames = torch.zeros(1, 1, 8, 8, dtype=torch.uint8)
    with pytest.raises(TypeError, match="float32"):
        kernels.median(frames.float(), 9)
    with pytest.raises(ValueError, match="give \\(B, 1, H, W\\)"):
        kernels.median(frames[0], 9)
    for size in (-1, 1, 4, 33):
        with pytest.raises(ValueError, match=f"{size} was asked for"):
            kernels.median(frames, size)
