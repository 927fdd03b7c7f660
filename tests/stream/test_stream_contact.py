"""The contact of a stream beside the contact graph of recordings, on a press with known truth."""

import numpy as np
import pytest
import torch
from torch import Tensor

from fingerflow.graphs import ContactGraph
from fingerflow.ops.median import median_filter
from fingerflow.stream.background import BackgroundStep
from fingerflow.stream.contact import ContactStep
from fingerflow.stream.lattice_median import median_on_lattice
from fingerflow.stream.levels import median_level, otsu_classes
from fingerflow.stream.measured_contact import MeasuredContactStep
from fingerflow.stream.median_planes import majority, median_of_rows
from fingerflow.stream.nearest_byte import nearest_byte
from fingerflow.stream.region import RegionStep
from fingerflow.synthetic import Press

SCENE = Press()
NAN = torch.tensor([torch.nan])


def _view(picture: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(SCENE.views["contact"].crop(picture)))[None, None]


@pytest.fixture(scope="module")
def empty() -> Tensor:
    return _view(SCENE.empty())


@pytest.mark.parametrize("size", [1, 3, 5, 7])
@pytest.mark.parametrize("shape", [(2, 1, 61, 47), (1, 1, 48, 50)])
def test_median_of_rows_is_the_median(size: int, shape: tuple[int, ...]) -> None:
    frames = torch.randint(0, 256, shape, dtype=torch.uint8, generator=torch.Generator().manual_seed(size))
    assert torch.equal(median_of_rows(frames, size), median_filter(frames, size))
    assert torch.equal(median_of_rows(frames.float(), size), median_filter(frames, size).float())


@pytest.mark.parametrize("size", [1, 3, 5, 9, 15])
@pytest.mark.parametrize("step", [1, 2, 3, 8, 16])
@pytest.mark.parametrize("kind", [torch.uint8, torch.float32, torch.float16])
def test_median_on_lattice_is_that_of_all_windows(size: int, step: int, kind: torch.dtype) -> None:
    for shape in ((2, 1, 61, 47), (1, 1, 48, 50), (1, 1, 5, 7)):  # frames smaller than a window, too
        frames = torch.randint(0, 256, shape, dtype=torch.uint8, generator=torch.Generator().manual_seed(size))
        expected = median_filter(frames, size)[..., ::step, ::step]
        assert torch.equal(median_on_lattice(frames.to(kind), size, step), expected.to(kind))


def test_lattice_has_the_threshold_of_its_medians(empty: Tensor) -> None:
    view = _view(SCENE.render(150))
    background = BackgroundStep()(empty, torch.zeros_like(empty), NAN)[:3]
    for lattice in (2, 3, 8):
        found = MeasuredContactStep(median_px=9, lattice_px=lattice)(view, *background)
        limit = BackgroundStep()(empty, torch.zeros_like(empty), found.threshold).limit
        every = MeasuredContactStep(median_px=9)(view, *background)
        assert torch.equal(ContactStep(9)(view, limit, background[2]).touching, found.touching)
        torch.testing.assert_close(found.threshold, every.threshold, rtol=0, atol=6e-3)


@pytest.mark.parametrize("size", [1, 3, 5, 9, 13])
def test_majority_is_the_median_of_zeros_and_ones(size: int) -> None:
    frames = torch.randint(0, 2, (2, 1, 53, 31), dtype=torch.uint8, generator=torch.Generator().manual_seed(size))
    assert torch.equal(majority(frames, size), median_filter(frames, size))


def test_bytes_are_the_nearest_whole_numbers() -> None:
    values = torch.tensor([-300.0, -0.5, 0.5, 1.5, 2.5, 2.4999998, 254.5, 255.5, 1e9])
    assert nearest_byte(values).tolist() == [0, 0, 0, 2, 2, 2, 254, 255, 255]


@pytest.mark.parametrize("frame", [40, 150, 299])
def test_contact_is_that_of_the_graph_of_recordings(frame: int, empty: Tensor) -> None:
    view, dark = _view(SCENE.render(frame)), torch.zeros_like(empty)
    graph = ContactGraph()(view, empty)
    background = BackgroundStep()(empty, dark, graph.threshold.float())
    contact = ContactStep()(view, background.limit, background.valid)
    # Levels are rounded to 1/204 of the light, the graph's signal is not: one pixel in a thousand lies between.
    assert (contact.touching.bool() != graph.real).sum() <= 2e-3 * graph.real.sum()
    # Cells of 4 px in place of pixels; the truth of a press is known to 0.4 % (README).
    torch.testing.assert_close(contact.gross_area_px.double(), graph.gross_area_px, rtol=0.008, atol=0)
    torch.testing.assert_close(contact.semi_axes.double(), graph.ellipse.semi_axes, rtol=0.01, atol=0)
    torch.testing.assert_close(contact.center.double(), graph.ellipse.center, rtol=0, atol=0.3)


@pytest.mark.parametrize(("lattice", "scatter", "tolerance"), [(1, True, 5e-4), (1, False, 5e-4), (8, True, 6e-3)])
def test_threshold_is_that_of_the_graph_of_recordings(
    lattice: int, scatter: bool, tolerance: float, empty: Tensor
) -> None:
    view = _view(SCENE.render(150))
    gain, offset, valid, _ = BackgroundStep()(empty, torch.zeros_like(empty), NAN)
    measured = MeasuredContactStep(lattice_px=lattice, scatter=scatter)(view, gain, offset, valid)
    expected = ContactGraph().threshold(view, empty)
    torch.testing.assert_close(measured.threshold.double(), expected, rtol=0, atol=tolerance)


def test_limit_of_counts_decides_as_levels_do(empty: Tensor) -> None:
    view = _view(SCENE.render(150))
    gain, offset, valid, _ = BackgroundStep()(empty, torch.zeros_like(empty), NAN)
    measured = MeasuredContactStep()(view, gain, offset, valid)
    limit = BackgroundStep()(empty, torch.zeros_like(empty), measured.threshold).limit
    assert torch.equal(ContactStep()(view, limit, valid).touching, measured.touching)


@pytest.mark.parametrize("name", ["empty glass", "saturated"])
def test_without_contact_there_is_no_threshold(name: str, empty: Tensor) -> None:
    frames = {"empty glass": empty, "saturated": torch.full_like(empty, 255)}
    gain, offset, valid, limit = BackgroundStep()(empty, torch.zeros_like(empty), NAN)
    measured = MeasuredContactStep()(frames[name], gain, offset, valid)
    assert measured.threshold.isnan().all()
    assert measured.touching.sum() == 0
    assert measured.gross_area_px == 0
    assert measured.semi_axes.isnan().all()
    assert ContactStep()(frames[name], limit, valid).touching.sum() == 0


@pytest.mark.parametrize("cell", [4, 8])
def test_region_of_an_ellipse_has_its_area_and_axes(cell: int) -> None:
    y, x = torch.meshgrid(torch.arange(300.0), torch.arange(400.0), indexing="ij")
    right, down = x - 180.3, y - 140.7
    along, across = right * np.cos(0.3) + down * np.sin(0.3), down * np.cos(0.3) - right * np.sin(0.3)
    inside = (along / 120) ** 2 + (across / 80) ** 2 <= 1
    inside[120:160, 170:190] = False  # a hole belongs to the region
    inside[5:25, 370:395] = True  # dirt does not
    region = RegionStep(cell=cell)(inside[None, None].to(torch.uint8))
    # A full region's density ends half a box from its border: the level is corrected for curvature, to 1 %.
    torch.testing.assert_close(region.area_px, torch.tensor([np.pi * 120 * 80], dtype=torch.float32), rtol=0.01, atol=0)
    torch.testing.assert_close(region.semi_axes, torch.tensor([[120.0, 80.0]]), rtol=0.01, atol=0)
    torch.testing.assert_close(region.center, torch.tensor([[180.3, 140.7]]), rtol=0, atol=0.3)
    torch.testing.assert_close(region.angle, torch.tensor([0.3]), rtol=0, atol=0.01)


def test_otsu_and_median_of_two_groups_of_levels() -> None:
    counts = torch.zeros(3, 256)
    counts[0, 50], counts[0, 200] = 900, 100
    counts[1, 77] = 5
    classes = otsu_classes(counts)
    assert classes.threshold[0] == 50
    torch.testing.assert_close(torch.stack((classes.lower[0], classes.upper[0])), torch.tensor([50.0, 200.0]))
    assert classes.threshold[1:].isnan().all()
    torch.testing.assert_close(median_level(counts)[:2], torch.tensor([50 - 0.5 + 500 / 900, 77.0]))
