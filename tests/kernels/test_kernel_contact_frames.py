"""Tests of the contact of a frame in one call, against the graphs and ops that it replaces."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from fingerflow.engines import contact_view
from fingerflow.engines.contact_view import covers
from fingerflow.engines.engine import EngineSettings, FrameContact
from fingerflow.engines.native import NativeEngine
from fingerflow.graphs.contact_graph import ContactGraph
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.contact_sizes import cell_of
from tests.kernels.contact_frames import contact_frames
from tests.kernels.kernel_images import SHAPES, images

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], object]], Any]


def engine(median_px: int, radius: int, cell: int | None = None, stride_px: int = 2) -> NativeEngine:
    return NativeEngine(
        EngineSettings(
            median_px=median_px, gross_radius_px=radius, cell_px=cell or cell_of(radius), stride_px=stride_px
        )
    )


def same_contact(tracked: NativeEngine, graph: ContactGraph, *images: torch.Tensor, threshold: Any) -> FrameContact:
    """Assert that all results are those of the separate kernels, bit for bit, and return them."""
    frames, light, black = (image.numpy() for image in images)
    contact = tracked.contact(frames, (light, black), threshold)
    expected = graph(*images, torch.from_numpy((1 - threshold).astype(np.float32)))
    for name, tensor in expected._asdict().items():
        if tensor is None:  # the graph states no threshold
            continue
        assert np.array_equal(getattr(contact, name), tensor.numpy(), equal_nan=tensor.is_floating_point()), name
    return contact


@pytest.mark.parametrize("dtype", kernels.FRAME_KINDS)
@pytest.mark.parametrize("median", [1, 3, 9, 15])
def test_compiled_contact_agrees_with_its_graph(instruction_set: int, dtype: torch.dtype, median: int) -> None:
    for lights, radius in ((1, 8), (5, 3)):
        frames, light, black = contact_frames(5, 130, 170, dtype, lights)
        images_and_graph = engine(median, radius), ContactGraph(median, radius), frames, light, black
        contact = same_contact(*images_and_graph, threshold=np.array([0.3, 0.25, np.nan, 0.28, -0.3]))
        assert contact.gross_area_px[3] > 1000
        assert np.isfinite(contact.illumination_gain).any()


@pytest.mark.parametrize("shape", SHAPES)
def test_same_contact_of_any_image(shape: tuple[int, int, int]) -> None:
    """Both agree on images without visible empty glass, half of whose pixels are in contact."""
    frames = images(shape, torch.uint8, "random")
    light = images((1, *shape[1:]), torch.float32, "random", seed=1)
    for cell in (1, 4, 8):
        images_and_graph = engine(3, 8, cell), ContactGraph(3, 8, cell), frames, light, 0 * light
        same_contact(*images_and_graph, threshold=np.full(len(frames), 0.5))


def test_views_and_threads(torch_threads: Callable[[int], None]) -> None:
    """Results are the same for views of a larger frame, which are read in place, and for views that are copied, with
    one frame in bands or one frame for each thread.
    """
    whole, light, black = (tensor.numpy() for tensor in contact_frames(5, 130, 170, torch.uint16))
    native, every = engine(3, 8), slice(None)
    for some, part in (
        (every, np.s_[..., 10:120, 20:]),
        (slice(3, 4), np.s_[..., 5:, :160]),
        (slice(None, None, 2), np.s_[..., ::-1, :]),
        (every, np.s_[..., ::2]),
    ):
        view, lamp, dark = whole[some][part], light[part], black[part]
        limits = np.full(len(view), 0.28, np.float32)
        copy, *glass = (np.ascontiguousarray(image) for image in (view, lamp, dark))
        torch_threads(1)
        expected = native.contact(copy, tuple(glass), limits)
        threshold = native.contact(copy, tuple(glass)).threshold
        for threads in (1, 2, 3, 7):
            torch_threads(threads)
            for value, other in zip(native.contact(view, (lamp, dark), limits), expected, strict=True):
                assert np.array_equal(value, other, equal_nan=value.dtype != np.bool_)
            assert np.array_equal(native.contact(view, (lamp, dark)).threshold, threshold, equal_nan=True)


@pytest.mark.parametrize(("down", "across"), [(1, 1), (1, 7), (9, 1), (2, 2), (31, 42)])
def test_same_points_covered(down: int, across: int, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(down)
    margin = random.uniform(-1, 1, (3, 1, down, across)).astype(np.float32)
    for cell in (1, 4):
        points = random.uniform(-3, [cell * across + 3, cell * down + 3], (3, 500, 2)).astype(np.float32)
        points[0, :4] = [[np.nan, 1], [1, np.inf], [1e30, 1], [-0.5, -0.5]]
        moved = np.array([[0.98, 0.03, 0.7], [-0.02, 1.01, -1.2]], np.float32)
        for transform in (np.array([[1, 0, 0], [0, 1, 0]], np.float32), moved):
            found = covers(margin, points, transform, cell)
            with monkeypatch.context() as patch:
                patch.setattr(contact_view, "is_present", lambda: False)
                expected = covers(margin, points, transform, cell)
            if transform is moved:
                # A sum may round otherwise, which decides for points within 1e-4 px of the border.
                assert (found != expected).mean() < 0.002
            else:
                assert np.array_equal(found, expected)
    assert covers(margin, points[:, :0], moved, 4).shape == (3, 0)
    assert covers(margin[:0], points[:0], moved, 4).shape == (0, 500)
