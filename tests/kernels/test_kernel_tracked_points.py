"""Tests of the tracker's kernels on NumPy arrays against the torch graphs and ops that they replace."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from fingerflow.engines.engine import Array, EngineSettings
from fingerflow.engines.native import NativeEngine
from fingerflow.graphs.detect import DetectGraph
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels import tracking as native
from fingerflow.kernels.library import compiled
from fingerflow.ops.tracking.search import search_and_return
from tests.kernels.twins import places_in_skin, searched_images, skin
from tests.ops.tracking import test_outliers as fields
from tests.small_trials import TINY_PRESS, TRIALS

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], Any]], Any]
Threads = Callable[[int], None]


def judged(points: torch.Tensor, moved: torch.Tensor, deviation: torch.Tensor, gauge: float) -> tuple[Array, Array]:
    neighbours = native.find_neighbours(points[0].numpy(), gauge)
    return native.find_outliers(neighbours, moved.numpy(), deviation.contiguous().numpy())


@pytest.mark.parametrize("name", fields.FIELDS)
def test_the_same_outliers(name: str, instruction_set: int, torch_threads: Threads) -> None:
    """Both forms find the same outliers, except for one or two of 100,000 that stand on a limit, where rounding
    decides.
    """
    torch_threads(3)
    moved, deviation = fields.measured(fields.FIELDS[name])
    differ = 0
    for size in (0.0, 0.1, 0.3, 1.0, 5.0):
        given, _ = fields.planted(moved, size)
        given[torch.rand(given.shape[:2], generator=torch.Generator().manual_seed(5)) < 0.1] = torch.nan
        expected = fields.find(given, deviation)
        for one, other in zip(judged(fields.POINTS, given, deviation, fields.GAUGE), expected, strict=True):
            differ += int((one != other.numpy()).sum())
    assert differ <= 2


def test_few_points_and_points_that_are_none() -> None:
    """Both forms find the same outliers for few points, points without a position or neighbours, points on a line, and
    no frame.
    """
    moved, deviation = fields.measured(fields.press)
    moved, deviation = moved[:2].clone(), deviation[:2].clone()
    deviation[0, :9], deviation[1, 3] = torch.inf, 0.0
    moved[1, 7], moved[0, 40] = torch.inf, 1e6
    unplaced = fields.POINTS.clone()
    unplaced[0, ::9] = torch.nan
    for points in (fields.POINTS, unplaced, fields.POINTS * torch.tensor([1.0, 0.0])):
        for count in (2, 3, 6, 16, 17, 300, 700):
            for gauge in (1.0, 30.0, 120.0):
                some = points[:, :count], moved[:, :count], deviation[:, :count]
                expected = fields.find(some[1], some[2], some[0], gauge)
                for one, other in zip(judged(*some, gauge), expected, strict=True):
                    np.testing.assert_array_equal(one, other.numpy())
    neighbours = native.find_neighbours(fields.POINTS[0].numpy(), 120.0)
    nothing = native.find_outliers(neighbours, np.zeros((0, 700, 2), np.float32), np.zeros((0, 700), np.float32))
    assert nothing[1].shape == (0, 700)


@pytest.mark.parametrize(("window", "radius"), [(25, 8), (21, 6), (9, 1), (15, 24)])
def test_the_same_search_both_ways(window: int, radius: int, instruction_set: int, torch_threads: Threads) -> None:
    """Bit for bit the same windows are found, there and back, in images of 8 and 16 bit and floating ones, because the
    kernels are those of the two searches.
    """
    torch_threads(3)
    key, current = searched_images()
    index = torch.arange(40) % 2
    guess = places_in_skin() + 0.3
    guess[0, 0], guess[1, 1], guess[2, 0] = torch.nan, torch.inf, 1e30
    for kinds in ((torch.float32, torch.float32), (torch.uint8, torch.uint16)):
        images = [one.clamp(0, 255).to(kind) for one, kind in zip((key, current), kinds, strict=True)]
        expected = search_and_return(images[0], images[1], index, places_in_skin(), guess, window, radius, 1.0)
        one, other = (image.numpy() for image in images)
        for given in ((one, other), (np.repeat(one, 2, axis=3)[..., ::2], np.repeat(other, 2, axis=2)[:, :, ::2])):
            size, reach = native.sizes_of(window, radius)
            positions = {"start": places_in_skin().numpy(), "guess": guess.numpy(), "image_index": index.numpy()}
            search = {"size": size, "reach": reach, "limit": 1.0 + native.SEARCHED}
            found = compiled("search_and_return")(key=given[0], current=given[1], **positions, **search)
            np.testing.assert_array_equal(found[0], expected[0].numpy())
            np.testing.assert_array_equal(found[1], expected[1].numpy())
    assert found[1].any()


def topography(press: Any) -> Array:
    """Return the topography view (1, 1, H, W) of a frame in contact, not copied, so that its rows are apart in
    memory.
    """
    return press.views["topography"].crop(press.render(3 * press.n_frames // 4))[None, None]


def pictures() -> dict[str, Array]:
    """Return frames (1, 1, H, W) on which points are detected, by name."""
    real = skin((0, 0), 0, (200, 260)).clamp(0, 255).numpy()
    random = np.random.default_rng(0)
    spoilt = real.copy()
    spoilt[..., 60, 90], spoilt[..., 120, 30] = np.nan, np.inf
    return {
        "skin": real,
        "8 bit": real.astype(np.uint8),
        "16 bit": (200 * real).astype(np.uint16),
        "saturated": np.clip(1.7 * real, 0, 255).astype(np.uint8),
        "press": topography(TRIALS["press"]),
        "tiny press": topography(TINY_PRESS),
        "noise": random.integers(0, 256, (1, 1, 150, 190), dtype=np.uint8),
        "noise of small numbers": random.normal(0, 1e-3, (1, 1, 150, 190)).astype(np.float32),
        "blank": np.full((1, 1, 90, 100), 7, np.uint8),
        "not finite": spoilt,
        "nowhere finite": np.full((1, 1, 90, 100), np.nan, np.float32),
        "small": real[..., :20, :24].astype(np.uint8),
        "smallest": real[..., :7, :7].astype(np.uint8),
    }


PICTURES = pictures()


@pytest.mark.parametrize("name", PICTURES)
def test_the_same_points_are_chosen(name: str, instruction_set: int, torch_threads: Threads) -> None:
    """Both forms detect the same points. Responses differ by a unit in the last place, the rounding of torch's roots,
    so that points of equal strength could be exchanged, but none are here.
    """
    torch_threads(3)
    frame = PICTURES[name]
    height, width = frame.shape[2:]
    y, x = np.mgrid[:height, :width]
    middle = ((x - width / 2) / width) ** 2 + ((y - height / 2) / height) ** 2 < 0.1
    ring = middle & (((x - width / 2) / width) ** 2 + ((y - height / 2) / height) ** 2 > 0.05)
    for mask in (np.ones_like(middle), middle, ring, (x > width - 20), np.zeros_like(middle)):
        for count, distance in ((100, 6.0), (10, 11.0), (3000, 2.0)):
            settings = EngineSettings(min_distance_px=distance, window_px=15)
            detected = NativeEngine(settings).detect(frame, mask, count)
            given = torch.from_numpy(np.ascontiguousarray(frame)), torch.from_numpy(mask)[None, None]
            points, _ = DetectGraph(count, distance, 15)(*given)
            assert chosen(detected) == chosen(points[0].numpy())
            assert len(detected) == len(chosen(detected))
    assert not len(detected)  # the last mask is empty


def chosen(points: Array) -> set[tuple[float, float]]:
    return {(float(x), float(y)) for x, y in points[np.isfinite(points).all(1)]}
