"""Tests of the contact of a frame in one call, against the graphs and ops that it replaces."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from fingerflow.engines.cells import covered
from fingerflow.graphs.contact_graph import ContactGraph
from fingerflow.kernels import contact_frames as native
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.contact_frames import ContactOfFrames, contact_of_frames
from fingerflow.kernels.contact_sizes import cell_of
from tests.kernels.contact_frames import contact_frames
from tests.kernels.kernel_images import SHAPES, images

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], object]], Any]


def same_contact(found: ContactOfFrames, graph: ContactGraph, *given: torch.Tensor) -> None:
    """Assert that all results are those of the separate kernels, bit for bit."""
    expected = graph(*given)
    assert np.array_equal(found.real_contact_mask, expected.real_contact_mask.numpy())
    assert np.array_equal(found.density_margin, expected.density_margin.numpy(), equal_nan=True)
    assert np.array_equal(found.gains, expected.illumination_gain.numpy(), equal_nan=True)
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
def test_compiled_contact_agrees_with_its_graph(instruction_set: int, dtype: torch.dtype, median: int) -> None:
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
    """Both agree on images without visible empty glass, half of whose pixels are in contact."""
    frames = images(shape, torch.uint8, "random")
    light = images((1, *shape[1:]), torch.float32, "random", seed=1)
    limits = torch.full(frames.shape[:1], 0.5)
    given = [tensor.numpy() for tensor in (frames, light, 0 * light, limits)]
    for cell in (1, 4, 8):
        found = contact_of_frames(*given, median_px=3, radius=8, cell=cell)
        same_contact(found, ContactGraph(3, 8, cell), frames, light, 0 * light, limits)


def test_views_and_threads(torch_threads: Callable[[int], None]) -> None:
    """Results are the same for views of a larger frame, which are read in place, and for views that are copied, with
    one frame in bands or one frame for each thread.
    """
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
            expected = covered(margin, points, transform, cell)
            if transform is moved:
                # A sum may round otherwise, which decides for points within 1e-4 px of the border.
                assert (found != expected).mean() < 0.002
            else:
                assert np.array_equal(found, expected)
    assert native.covered(margin, points[:, :0], moved, 4).shape == (3, 0)
    assert native.covered(margin[:0], points[:0], moved, 4).shape == (0, 500)
    strided = native.covered(margin[:, :, ::-1], points[:, ::2], moved, 4)
    assert np.array_equal(strided, native.covered(margin[:, :, ::-1].copy(), points[:, ::2].copy(), moved, 4))
