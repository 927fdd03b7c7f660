"""Tests of cells: means, interpolation between cells, and the positions that a region covers."""

import numpy as np
import pytest
import torch

from fingerflow.engines import contact_view
from fingerflow.ops.contact.cells import mask_of


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("cell", [1, 4])
def test_a_border_is_found_to_a_fraction_of_a_pixel(cell: int, compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A straight border at x = 21.3 px separates 21.25 px from 21.35 px; positions beyond the frame and positions that
    are NaN or infinite are not covered.
    """
    middles = cell * torch.arange(40 // cell) + (cell - 1) / 2
    density_margin = (21.3 - middles).expand(1, 1, 30 // cell, -1)
    x = [21.25, 21.35, -0.4, -0.6, np.nan, np.inf, 5.0, 5.0]
    y = [3.0, 3.0, 3.0, 3.0, 3.0, 3.0, 40.0, np.nan]
    if not compiled:
        monkeypatch.setattr(contact_view, "is_present", lambda: False)
    found = contact_view.covers(density_margin.numpy(), np.array([x, y], np.float32).T[None], np.eye(2, 3), cell)
    assert found.tolist() == [[True, False, True, False, False, False, False, False]]
    mask = mask_of(density_margin, cell, 28, 40)
    assert mask.shape == (1, 1, 28, 40)
    assert mask[..., :22].all()
    assert not mask[..., 22:].any()
