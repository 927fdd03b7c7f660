"""Skin that moves into a contact, and skin over which a contact grows."""

import pytest
import torch
from torch import Tensor

from fingerflow.ops.entry import MOVED_IN, entries, since_entry
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


@pytest.mark.usefixtures("each_form")
def test_gradient_since_entry() -> None:
    """Of skin that deforms alike everywhere, F(t) = I + t A, every point that has begun at its own time: exact, but for
    the rounding of places of some mm, 5e-7 mm each, of a dozen points over a gauge length of which they are known. One
    that was lost when it began stays unknown.
    """
    generator = torch.Generator().manual_seed(2)
    chosen = 6 * torch.rand(1, 900, 2, generator=generator)
    onset = torch.randint(1, 6, (1, 900), generator=generator)
    rate, identity = torch.tensor([[0.03, 0.02], [-0.05, -0.04]]), torch.eye(2)
    entered = torch.arange(900)[None] % 3 > 0
    lost = (torch.arange(900)[None] % 50 == 7) & entered
    at_entry, since = torch.full((2, 1, 900, 2, 2), torch.nan)
    for time in range(8):
        moved = time * chosen @ rate.T
        moved[lost & (onset == time)] = torch.nan
        since, at_entry = since_entry(at_entry, chosen, moved, onset == time, entered & (onset <= time), GAUGE)
    begun = identity + onset[..., None, None] * rate
    expected = (identity + 7 * rate) @ torch.linalg.inv(begun) - identity
    expected[~entered | lost] = torch.nan
    torch.testing.assert_close(since, expected, rtol=0, atol=5e-5, equal_nan=True)
    nobody = torch.zeros_like(entered)
    assert since_entry(at_entry, chosen, moved, nobody, nobody, GAUGE)[0].isnan().all()
