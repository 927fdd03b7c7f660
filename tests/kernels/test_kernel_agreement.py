"""Tests of compiled against portable forms on hard cases drawn by seed: the same statuses, the same NaN, and numbers
within a tolerance.

Each draw is a pair of frames (ridges of any contrast, saturated or blank; noise from none to more than the ridges; 8
and 16 bit and floating, with pixels that are NaN or infinite), points all over the frame and outside it, on whole
pixels and between them, motion from none to further than a search reaches, and random settings.
"""

from collections.abc import Callable
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.ops.contact.apparent_contact import apparent_contact
from fingerflow.ops.fields.point_gradients import point_gradients
from fingerflow.ops.tracking.search import search_windows
from fingerflow.ops.tracking.templates import find_templates, prepare_templates
from fingerflow.ops.tracking.track_points import track_points
from fingerflow.synthetic import RidgeTexture

pytestmark = [pytest.mark.long, pytest.mark.skipif(not kernels.serve(), reason="no compiled kernels, or turned off")]

Portable = Callable[[Callable[[], object]], Any]
DRAWS, POINTS = 50, 50
# Tolerances of a position, as a share of its standard deviation and in px. Both forms take the same steps; a nearly
# singular structure tensor amplifies rounding of float32 as much as noise. Most positions differ by 1e-5 px, the
# rounding of coordinates.
OF_DEVIATION, ROUNDING_PX = 0.05, 2e-4


class Draw(NamedTuple):
    """Two frames (B, 1, H, W), points (B, N, 2) px, and settings."""

    first: Tensor
    second: Tensor
    points: Tensor
    settings: dict[str, Any]


def drawn(seed: int, size: tuple[int, int] = (90, 110)) -> Draw:
    random = np.random.default_rng(seed)
    kind = random.choice(["uint8", "uint16", "float", "holes"])
    noise, contrast = random.choice([0.0, 0.5, 2.0, 8.0, 25.0]), random.choice([0.0, 2.0, 10.0, 80.0, 300.0])
    motion = random.uniform(-1, 1, 2) * random.choice([0.0, 0.5, 2.0, 6.0, 12.0])
    if seed % 5 == 0:
        motion = motion.round()
    batch = 1 + seed % 2
    first, second = (
        torch.stack([_picture(shift, noise, contrast, size, seed * 4 + 2 * k + later) for k in range(batch)])[:, None]
        for later, shift in enumerate((np.zeros(2), motion))
    )
    if kind == "uint8":
        first, second = (one.round().clamp(0, 255).to(torch.uint8) for one in (first, second))
    elif kind == "uint16":
        first, second = ((16 * one).round().clamp(0, 4095).to(torch.uint16) for one in (first, second))
    else:
        first, second = first.float(), second.float()
    if kind == "holes":
        down, across = size[0] // 3, size[1] // 3
        first[0, 0, down : down + 2, across : across + 3], second[0, 0, 2 * down, 2 * across] = torch.nan, torch.inf
    points = torch.from_numpy(random.uniform(-8, [size[1] + 8, size[0] + 8], (batch, POINTS, 2))).float()
    if seed % 3 == 0:
        points = points.round()
    points[0, 0], points[0, 1] = torch.nan, torch.inf
    settings = {
        "window": int(random.choice([5, 9, 15, 21, 31])),
        "gain_offset": bool(random.integers(2)),
        "search": int(random.choice([0, 8])),
        "passes": int(random.choice([1, 2])),
    }
    return Draw(first, second, points, settings)


def _picture(shift: Any, noise: float, contrast: float, size: tuple[int, int], seed: int) -> Tensor:
    y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in size), indexing="ij")
    ridges = RidgeTexture()((x - shift[0]) * 0.0325, (y - shift[1]) * 0.0325)
    grain = torch.randn(size, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return 110 + contrast * ridges + noise * grain


def same_found(found: Any, expected: Any, case: str) -> int:
    """Assert that statuses, NaN and numbers of points (B, N) agree; return how many points have a position."""
    differ = (found.status != expected.status).nonzero().tolist()
    said = [(place, int(found.status[*place]), int(expected.status[*place])) for place in differ]
    assert not said, f"{case}: statuses of points {said}"
    tracked = expected.status == TrackStatus.TRACKED
    known = tracked | (expected.status >= TrackStatus.MISMATCH)
    for one in (found, expected):
        assert torch.equal(one.points.isfinite().all(-1), tracked), case
        assert torch.equal(one.covariance.isfinite().all(-1).all(-1), tracked), case
        assert torch.equal(one.error.isfinite(), known), case
    deviation = expected.covariance[tracked].diagonal(dim1=-2, dim2=-1).amax(-1).sqrt()
    limit = ROUNDING_PX + OF_DEVIATION * deviation
    off = (found.points[tracked] - expected.points[tracked]).abs().amax(-1)
    assert (off <= limit).all(), f"{case}: {(off / limit).max():.2f} of the tolerance in positions"
    return int(tracked.sum())


def test_tracked_points(instruction_set: int, portable: Portable) -> None:
    tracked = 0
    for seed in range(DRAWS):
        first, second, points, settings = drawn(seed)

        def call() -> Any:
            return track_points(first, second, points, **settings)  # noqa: B023

        tracked += same_found(call(), portable(call), f"draw {seed}, {settings}")
    assert tracked > 300


def test_templates_with_a_warp(instruction_set: int, portable: Portable) -> None:
    """Templates prepared for any deformation, also large ones, are found alike by both forms."""
    tracked = 0
    for seed in range(DRAWS):
        first, second, points, settings = drawn(seed)
        random = torch.Generator().manual_seed(seed)
        size = (0.02, 0.1, 0.6)[seed % 3]
        warp = torch.eye(2) + size * (torch.rand(*points.shape, 2, generator=random) - 0.5)

        def call() -> Any:
            window, free = settings["window"], settings["gain_offset"]  # noqa: B023
            kept = prepare_templates(first, points, window, warp, gain_offset=free)  # noqa: B023
            return find_templates(kept, second, points + 0.3, rounds=(1, 2, 8)[seed % 3])  # noqa: B023

        tracked += same_found(call(), portable(call), f"draw {seed}, {settings}")
    assert tracked > 100


def test_searched_windows(instruction_set: int, portable: Portable) -> None:
    """Of equally similar positions, as in saturated pictures, both forms take the same one. Outside the frame, where
    its border is repeated, many positions are equal along it, and rounding decides in up to one of 500.
    """
    beyond = differing = 0
    for seed in range(DRAWS):
        first, second, points, settings = drawn(seed)
        index = torch.arange(len(points))[:, None].expand(points.shape[:2]).flatten()
        flat = points.flatten(0, 1)
        guess = flat + 3 * torch.randn(flat.shape, generator=torch.Generator().manual_seed(seed))
        radius = (1, 6, 13, 24)[seed % 4]

        def call() -> Any:
            return search_windows(first, second, index, flat, guess, settings["window"], radius)  # noqa: B023

        found, expected = call(), portable(call)
        assert torch.equal(found.isfinite(), expected.isfinite()), f"draw {seed}"
        # The position is a start for the tracker, good to about a pixel; the vertex of three scores is good to 1e-4 px.
        apart = (found - expected).abs().nan_to_num(0.0).amax(-1) > 1e-3
        inside = ((flat > 16) & (flat < torch.tensor([94.0, 74.0]))).all(-1)
        assert not apart[inside].any(), f"draw {seed}: {flat[inside & apart]}"
        beyond, differing = beyond + int((~inside).sum()), differing + int(apart.sum())
    assert beyond > 1000
    assert differing <= beyond / 500


@pytest.mark.parametrize("size", [(4, 4), (5, 31), (12, 9)])
def test_tiny_frames(portable: Portable, size: tuple[int, int]) -> None:
    for seed in range(12):
        first, second, points, settings = drawn(seed, size)

        def call() -> Any:
            return track_points(first, second, points, **settings)  # noqa: B023

        same_found(call(), portable(call), f"draw {seed}, {settings}")


@pytest.mark.parametrize("size", [(40, 50), (9, 12)])
def test_windows_searched_outside_the_image(portable: Portable, size: tuple[int, int]) -> None:
    """Searches outside the image agree, up to positions that no integer can hold: the repeated border is blank
    there.
    """
    first, second = (torch.rand(1, 1, *size, generator=torch.Generator().manual_seed(k)) * 100 for k in range(2))
    far = [0.0, 5.0, -5.0, 20.0, -20.0, 50.0, -100.0, 300.0, -1e3, 1e5, -1e9, 2.0**33, 1e19, 1e30, -3e38]
    places = torch.tensor([place for one in far for place in ((one, one), (one, 7.0), (7.0, one))])
    middle = torch.tensor([size[1] / 2, size[0] / 2]).expand_as(places)
    index = torch.zeros(len(places), dtype=torch.int64)
    for (window, radius), (points, guess) in product(
        ((5, 1), (9, 6), (21, 24), (21, 100), (9, 200)), ((places, middle), (middle, places), (places, places))
    ):

        def call() -> Any:
            return search_windows(first, second, index, points, guess, window, radius)  # noqa: B023

        torch.testing.assert_close(call(), portable(call), rtol=1e-5, atol=2e-2)


def test_cells_wider_than_a_byte_counts() -> None:
    """All pixels of a full mask count in cells with more rows than a byte can count."""
    mask = torch.ones(1, 1, 600, 300, dtype=torch.bool)
    for cell in (255, 256, 400, 511):
        assert float(apparent_contact(mask, 255, cell).real_area_px) == pytest.approx(600 * 300, rel=1e-6)


def test_gradients_where_a_covariance_is_not_known(portable: Portable) -> None:
    """In both forms a point whose covariance is not known takes part in no fit and has no gradient."""
    random = torch.Generator().manual_seed(0)
    reference, displacement = 10 * torch.rand(1, 40, 2, generator=random), torch.rand(3, 40, 2, generator=random)
    covariance = torch.eye(2).repeat(3, 40, 1, 1) / 100
    covariance[0, 3], covariance[1, 4, 0, 0], covariance[2, 5, 1, 1] = torch.nan, -1.0, torch.inf

    def call() -> Any:
        return point_gradients(reference, displacement, 8.0, covariance)

    for found, expected in zip(call(), portable(call), strict=True):
        torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-4, equal_nan=True)
        for frame, point in ((0, 3), (1, 4), (2, 5)):
            assert found[frame, point].isnan().all()
        assert found.isfinite().float().mean() > 0.9
