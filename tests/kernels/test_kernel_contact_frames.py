"""The contact of a frame in one call, beside the graphs and ops that it is made of."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from contact_frames import contact_frames
from kernel_images import SHAPES, images

from fingerflow.graphs.contact import ContactGraph
from fingerflow.kernels import contact_frames as native
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.contact_frames import ContactOfFrames, contact_of_frames
from fingerflow.kernels.contact_sizes import cell_of
from fingerflow.ops.contact.cells import covered
from fingerflow.ops.contact.contact_threshold import contact_threshold

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], object]], Any]
# Both forms take the same levels; a cell at the border whose density differs by rounding takes some pixels with it.
ROUNDING = 1e-4


def same_contact(found: ContactOfFrames, graph: ContactGraph, *given: torch.Tensor) -> None:
    """Bit for bit as the kernels one after the other."""
    expected = graph(*given)
    assert np.array_equal(found.real_contact_mask, expected.real_contact_mask.numpy())
    assert np.array_equal(found.density_margin, expected.density_margin.numpy(), equal_nan=True)
    assert np.array_equal(found.gains, expected.light_gain.numpy(), equal_nan=True)
    numbers = (
        expected.real_area_px[:, None],
        expected.gross_area_px[:, None],
        expected.center,
        expected.semi_axes,
        expected.angle[:, None],
    )
    assert np.array_equal(found.numbers, torch.cat(numbers, 1).numpy(), equal_nan=True)


@pytest.mark.parametrize("dtype", kernels.FRAME_KINDS)
@pytest.mark.parametrize("median", [1, 3, 9, 15])
def test_same_contact(instruction_set: int, dtype: torch.dtype, median: int) -> None:
    for lights, radius in ((1, 8), (5, 3)):
        frames, light, black = contact_frames(5, 130, 170, dtype, lights)
        limits = torch.tensor([0.7, 0.75, torch.nan, 0.72, 1.3])
        given = [tensor.numpy() for tensor in (frames, light, black, limits)]
        found = contact_of_frames(*given, median_px=median, radius=radius, cell=cell_of(radius))
        same_contact(found, ContactGraph(median, radius), frames, light, black, limits)
        assert found.numbers[3, 1] > 1000
        assert np.isfinite(found.gains).any()


@pytest.mark.parametrize("shape", SHAPES)
def test_same_contact_of_any_image(shape: tuple[int, int, int]) -> None:
    """Nothing is seen of the empty glass, and half of the pixels touch."""
    frames = images(shape, torch.uint8, "random")
    light = images((1, *shape[1:]), torch.float32, "random", seed=1)
    limits = torch.full(frames.shape[:1], 0.5)
    given = [tensor.numpy() for tensor in (frames, light, 0 * light, limits)]
    for cell in (1, 4, 8):
        found = contact_of_frames(*given, median_px=3, radius=8, cell=cell)
        same_contact(found, ContactGraph(3, 8, cell), frames, light, 0 * light, limits)


@pytest.mark.parametrize("dtype", kernels.FRAME_KINDS)
@pytest.mark.parametrize(("median", "radius", "stride"), [(3, 8, 1), (3, 8, 8), (1, 5, 3), (9, 8, 8), (13, 8, 2)])
def test_same_threshold(
    instruction_set: int,
    portable: Portable,
    monkeypatch: pytest.MonkeyPatch,
    dtype: torch.dtype,
    median: int,
    radius: int,
    stride: int,
) -> None:
    for lights, gain in ((1, None), (5, torch.tensor([1.0, 0.98, torch.nan, 1.04, 1.08]))):
        frames, light, black = contact_frames(5, 130, 170, dtype, lights)

        def call() -> torch.Tensor:
            sizes = {"median_px": median, "radius": radius, "stride_px": stride}
            return contact_threshold(frames, light, black, gain, **sizes)  # noqa: B023

        found = call()
        assert found.isfinite().sum() >= 3
        torch.testing.assert_close(found, portable(call), rtol=0, atol=ROUNDING, equal_nan=True)
        with monkeypatch.context() as patch:  # the other kernels serve
            patch.setattr(kernels, "LARGEST_MAJORITY", 0)
            torch.testing.assert_close(found, call(), rtol=0, atol=ROUNDING / 10, equal_nan=True)


def test_no_contact_has_no_threshold(portable: Portable) -> None:
    """Empty glass, a constant frame, one without light, and no frame."""
    frames, light, black = contact_frames(2, 64, 80, torch.uint8)
    for some, lamp in ((frames[:1], light), (frames * 0 + 90, light), (frames, 0 * light), (frames[:0], light)):
        found = contact_threshold(some, lamp, black)
        assert found.shape == some.shape[:1]
        assert found.isnan().all()
        assert portable(lambda s=some, a=lamp: contact_threshold(s, a, black)).isnan().all()


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 130), (2, 130, 1), (1, 3, 2), (5, 37, 41), (2, 33, 800)])
def test_thresholds_of_any_image(portable: Portable, shape: tuple[int, int, int]) -> None:
    """Smaller than windows and cells."""
    frames = images(shape, torch.uint8, "two levels")
    light, black = torch.full((1, 1, *shape[1:]), 250.0), torch.zeros(1, 1, *shape[1:])
    for median, stride in ((3, 1), (15, 8), (5, 3)):

        def call() -> torch.Tensor:
            return contact_threshold(frames, light, black, median_px=median, stride_px=stride)  # noqa: B023

        torch.testing.assert_close(call(), portable(call), rtol=0, atol=1e-2, equal_nan=True)


def test_views_and_threads(torch_threads: Callable[[int], None]) -> None:
    """Views of a larger frame are read in place; others are copied. One frame in bands, and a frame a thread."""
    whole, light, black = (tensor.numpy() for tensor in contact_frames(5, 130, 170, torch.uint16))
    sizes = {"median_px": 3, "radius": 8}
    every = slice(None)
    for some, part in (
        (every, np.s_[..., 10:120, 20:]),
        (slice(3, 4), np.s_[..., 5:, :160]),
        (slice(None, None, 2), np.s_[..., ::-1, :]),
        (every, np.s_[..., ::2]),
    ):
        view, lamp, dark = whole[some][part], light[part], black[part]
        limits = np.full(len(view), 0.72, np.float32)
        copies = [np.ascontiguousarray(one) for one in (view, lamp, dark)]
        torch_threads(1)
        expected = contact_of_frames(*copies, limits, cell=4, **sizes)
        threshold = native.contact_threshold(*copies, stride_px=2, **sizes)
        for threads in (1, 2, 3, 7):
            torch_threads(threads)
            for one, other in zip(contact_of_frames(view, lamp, dark, limits, cell=4, **sizes), expected, strict=True):
                assert np.array_equal(one, other, equal_nan=True)
            found = native.contact_threshold(view, lamp, dark, stride_px=2, **sizes)
            assert np.array_equal(found, threshold, equal_nan=True)


@pytest.mark.parametrize(("down", "across"), [(1, 1), (1, 7), (9, 1), (2, 2), (31, 42)])
def test_same_points_covered(down: int, across: int) -> None:
    random = np.random.default_rng(down)
    margin = random.uniform(-1, 1, (3, 1, down, across)).astype(np.float32)
    for cell in (1, 4):
        points = random.uniform(-3, [cell * across + 3, cell * down + 3], (3, 500, 2)).astype(np.float32)
        points[0, :4] = [[np.nan, 1], [1, np.inf], [1e30, 1], [-0.5, -0.5]]
        moved = np.array([[0.98, 0.03, 0.7], [-0.02, 1.01, -1.2]], np.float32)
        for transform in (np.array([[1, 0, 0], [0, 1, 0]], np.float32), moved):
            found = native.covered(margin, points, transform, cell)
            x, y = (torch.from_numpy(points) @ torch.from_numpy(transform[:, :2]).T).unbind(-1)
            x, y = x + float(transform[0, 2]), y + float(transform[1, 2])
            expected = covered(torch.from_numpy(margin), x, y, cell).numpy()
            if transform is moved:
                # A product of matrices may round otherwise: so may points that lie on the border to 1e-4 px.
                assert (found != expected).mean() < 0.002
            else:
                assert np.array_equal(found, expected)
    assert native.covered(margin, points[:, :0], moved, 4).shape == (3, 0)
    assert native.covered(margin[:0], points[:0], moved, 4).shape == (0, 500)
    strided = native.covered(margin[:, :, ::-1], points[:, ::2], moved, 4)
    assert np.array_equal(strided, native.covered(margin[:, :, ::-1].copy(), points[:, ::2].copy(), moved, 4))


def test_refuses_what_does_not_fit() -> None:
    frames, image = np.zeros((2, 1, 16, 16), np.uint8), np.ones((1, 1, 16, 16), np.float32)
    limits = np.zeros(2, np.float32)
    sizes: dict[str, Any] = {"median_px": 3, "radius": 8, "cell": 4}
    for name, value, said in (("median_px", 4, "odd sizes"), ("median_px", 17, "odd sizes"), ("radius", 0, "radius")):
        with pytest.raises(ValueError, match=said):
            contact_of_frames(frames, image, image, limits, **{**sizes, name: value})
    with pytest.raises(ValueError, match="cells of 3 px"):
        contact_of_frames(frames, image, image, limits, median_px=3, radius=8, cell=3)
    with pytest.raises(ValueError, match="limits is"):
        contact_of_frames(frames, image, image, limits[:1], **sizes)
    with pytest.raises(TypeError, match="black is float64"):
        contact_of_frames(frames, image, image.astype(np.float64), limits, **sizes)
    with pytest.raises(TypeError, match="frames are >u2"):
        contact_of_frames(frames.astype(">u2"), image, image, limits, **sizes)
    with pytest.raises(ValueError, match="give \\(B, 1, H, W\\)"):
        contact_of_frames(frames[:, 0], image, image, limits, **sizes)
    with pytest.raises(ValueError, match="light of"):
        native.contact_threshold(frames, image[..., 1:], image, median_px=3, radius=8, stride_px=1)
    with pytest.raises(ValueError, match="gains is"):
        native.contact_threshold(frames, image, image, limits[1:], median_px=3, radius=8, stride_px=1)
    with pytest.raises(ValueError, match="one pixel of 0"):
        native.contact_threshold(frames, image, image, median_px=3, radius=8, stride_px=0)
    points, transform = np.zeros((1, 3, 2), np.float32), np.zeros((2, 3), np.float32)
    with pytest.raises(ValueError, match="points is"):
        native.covered(image, points[..., :1], transform, 4)
    with pytest.raises(ValueError, match="transform is"):
        native.covered(image, points, transform.T, 4)
    with pytest.raises(ValueError, match="density_margin"):
        native.covered(image[:, :, :0], points, transform, 4)
