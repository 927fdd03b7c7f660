"""Skin that moves into a contact, and skin over which a contact grows."""

import pytest
import torch
from torch import Tensor

from fingerflow.ops.entry import MOVED_IN, entries
from fingerflow.ops.onset import touch_length

GAUGE = 1.6  # mm
RADIUS = 2.0


def played(way: list[float], radius: list[float]) -> tuple[Tensor, Tensor]:
    """(N,) what `entries` says in the end, and where skin began, relative to a round contact of a radius (mm) in each
    frame, of skin that has gone a way (mm) by then.
    """
    axis = torch.arange(-5, 3, 0.25)
    skin = torch.stack(torch.meshgrid(axis, axis, indexing="xy"), dim=-1).flatten(0, 1)[None]
    entry, length = torch.zeros(2, 1, skin.shape[1], dtype=torch.uint8)
    onset = torch.full_like(skin, torch.nan)
    for gone, reach in zip(way, radius, strict=True):
        place = skin + torch.tensor([gone, 0.0])
        length = touch_length(length, place.norm(dim=-1) < reach)
        onset = torch.where((length == 1)[..., None], place, torch.where((length > 0)[..., None], onset, torch.nan))
        entry = entries(entry, place, (place - onset).norm(dim=-1), length, GAUGE)
    return entry[0], skin[0]


@pytest.mark.usefixtures("each_form")
def test_skin_that_slides_in_has_moved_in() -> None:
    """All that began outside and is inside in the end, also what came before its neighbours had moved far."""
    entry, skin = played([0.05 * k for k in range(40)], [RADIUS] * 40)
    inside = skin.norm(dim=-1) < RADIUS
    came = ~inside & ((skin + torch.tensor([36 * 0.05, 0.0])).norm(dim=-1) < RADIUS)
    assert came.sum() > 30
    assert (entry[came] == MOVED_IN).all()
    assert not (entry[inside] == MOVED_IN).any()


@pytest.mark.usefixtures("each_form")
def test_skin_that_a_contact_grows_over_has_not() -> None:
    """Also where it moves meanwhile, a tenth as fast as the border."""
    entry, _ = played([0.008 * k for k in range(30)], [0.3 + 0.08 * min(k, 26) for k in range(30)])
    assert (entry == 1).sum() > 100
    assert not (entry == MOVED_IN).any()
