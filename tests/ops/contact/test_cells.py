"""Tests of cells: means, interpolation between cells, and the positions that a region covers."""

import pytest
import torch

from fingerflow.ops.contact.cells import at_places, cell_means, covered, largest_around, mask_of


@pytest.mark.parametrize("cell", [1, 2, 4, 8])
@pytest.mark.parametrize("shape", [(2, 1, 16, 24), (1, 1, 13, 9), (1, 1, 1, 1)])
def test_means(cell: int, shape: tuple[int, ...]) -> None:
    mask = torch.rand(shape, generator=torch.Generator().manual_seed(cell)) < 0.4
    means = cell_means(mask, cell)
    assert torch.equal(means, cell_means(mask.float(), cell))
    assert float(means.sum() * cell**2) == int(mask.sum())
    first = mask[0, 0, :cell, :cell].sum() / cell**2
    assert float(means[0, 0, 0, 0]) == pytest.approx(float(first))


def test_values_between_cells_are_those_of_a_plane() -> None:
    y, x = torch.meshgrid(torch.arange(7.0), torch.arange(9.0), indexing="ij")
    cells = (2 + 0.5 * x - 0.25 * y)[None, None]
    places = torch.rand(2, 1, 50, generator=torch.Generator().manual_seed(0))
    across, along = 8 * places[0], 6 * places[1]
    torch.testing.assert_close(at_places(cells, across, along), 2 + 0.5 * across - 0.25 * along)
    assert at_places(cells, torch.tensor([[-5.0, 99.0]]), torch.tensor([[0.0, 99.0]])).tolist() == [[2.0, 4.5]]
    assert at_places(cells[..., :1, :1], torch.zeros(1, 1), torch.zeros(1, 1)).tolist() == [[2.0]]


@pytest.mark.parametrize("cell", [1, 4])
def test_a_border_is_found_to_a_fraction_of_a_pixel(cell: int) -> None:
    """A straight border at x = 21.3 px separates 21.25 px from 21.35 px; positions beyond the frame and positions that
    are NaN or infinite are not covered.
    """
    middles = cell * torch.arange(40 // cell) + (cell - 1) / 2
    density_margin = (21.3 - middles).expand(1, 1, 30 // cell, -1)
    x = torch.tensor([[21.25, 21.35, -0.4, -0.6, torch.nan, torch.inf, 5.0, 5.0]])
    y = torch.tensor([[3.0, 3.0, 3.0, 3.0, 3.0, 3.0, 40.0, torch.nan]])
    assert covered(density_margin, x, y, cell).tolist() == [[True, False, True, False, False, False, False, False]]
    mask = mask_of(density_margin, cell, 28, 40)
    assert mask.shape == (1, 1, 28, 40)
    assert mask[..., :22].all()
    assert not mask[..., 22:].any()


def test_neighbourhoods() -> None:
    cells = torch.rand(2, 1, 6, 5, generator=torch.Generator().manual_seed(0))
    assert torch.equal(largest_around(cells), torch.nn.functional.max_pool2d(cells, 3, 1, 1))
