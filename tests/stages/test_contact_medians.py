"""Medians over the contact of a batch of frames, and the grid on which their fields are fitted."""

import numpy as np
import torch

from fingerflow.stages.contact import ContactSeries
from fingerflow.stages.contact_medians import ReferenceGrid, medians_over_contact


def test_grid_covers_what_is_known() -> None:
    assert ReferenceGrid.around(np.full((3, 2), np.nan), 0.2, 1.0) is None
    grid = ReferenceGrid.around(np.array([[2.0, 1.0], [14.0, 11.0], [np.nan, 0.0]]), 0.2, 1.0)
    assert grid is not None
    nodes = grid.nodes()
    np.testing.assert_allclose(nodes[0], (1.0, 0.0))
    np.testing.assert_allclose(nodes[grid.columns + 1], (1.2, 0.2))
    assert (nodes[-1] >= (15.0, 12.0)).all()
    assert (nodes[-1] <= (15.4, 12.4)).all()


def test_a_wrong_scale_does_not_ask_for_all_memory() -> None:
    grid = ReferenceGrid.around(np.array([[0.0, 0.0], [14000.0, 11000.0]]), 0.2, 1.0)
    assert grid is not None
    assert grid.columns * grid.rows < 210**2


def test_frames_of_a_batch_have_their_own_contact() -> None:
    """Medians of the reference position over still skin: the centre of each contact; NaN where there is none."""
    grid = ReferenceGrid.around(np.array([[2.0, 1.0], [14.0, 11.0]]), 0.2, 1.0)
    assert grid is not None
    nothing = np.zeros(4)
    contact = ContactSeries(
        threshold=nothing,
        real_area=nothing,
        gross_area=nothing,
        center=np.array([[0.0, 0.0], [8.0, 6.0], [7.0, 5.0], [np.nan, np.nan]]),
        semi_axes=np.array([[1.0, 1.0], [3.0, 2.0], [2.0, 1.0], [np.nan, np.nan]]),
        angle=np.array([0.0, 0.3, 1.0, np.nan]),
    )
    nodes = torch.from_numpy(grid.nodes()).float().expand(3, -1, -1)
    medians = medians_over_contact(contact, slice(1, 4), grid, torch.zeros_like(nodes), nodes)
    np.testing.assert_allclose(medians, [[8.0, 6.0], [7.0, 5.0], [np.nan, np.nan]], atol=0.02)
