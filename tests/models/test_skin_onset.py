"""Tests of the displacement and divergence since the contact of each point, as a camera sees them."""

import math

import pytest
import torch

from fingerflow.models.skin_chain import PressedChain, follow
from fingerflow.models.skin_onset import since_onset

TIMES = 201


def stretching(elements: int) -> PressedChain:
    """Return a press of undeformed skin that is laid down from the middle at 1 mm per unit of time while skin on the
    plate stretches.

    x(t) = xi (1 + c (t - xi)) for t > xi, so u = c xi (t - xi), and du/dxi + u/xi = c (2 t - 3 xi).
    """
    c = 0.02
    time = torch.linspace(0, 1, TIMES, dtype=torch.float64)
    place = torch.linspace(-1.2, 1.2, elements, dtype=torch.float64)
    waited = (time[:, None] - place.abs()).clamp_min(0)
    x = place * (1 + c * waited)
    z = torch.where(waited > 0, -waited, place.abs() - time[:, None])
    parts = dict(vars(follow(0.0, time[:2], 1.0, elements=5)))
    parts |= {"position": torch.stack((x, z), -1), "contact_length": 2 * time * 1.0}
    return PressedChain(**parts)


@pytest.mark.parametrize("elements", [240, 241])
def test_a_stretch_that_is_known(elements: int) -> None:
    """A known stretch is found: displacement to 2.5e-5, as positions are interpolated linearly between times 0.005
    apart and the onset is a kink of c xi; divergence to 1e-4, from neighbours 0.01 apart. On the axis this field has a
    kink itself.
    """
    found, time = since_onset(stretching(elements)), torch.linspace(0, 1, TIMES, dtype=torch.float64)
    k = 160
    place = torch.linspace(-1.2, 1.2, elements, dtype=torch.float64)[elements // 2 :]
    inside = (place < time[k] - 0.02) & (place > 1e-9)
    expected = 0.02 * (2 * time[k] - 3 * place)
    torch.testing.assert_close(found.divergence_field[k][inside], expected[inside], rtol=0, atol=1e-4)
    torch.testing.assert_close(
        found.displacement[k][inside], (0.02 * place * (time[k] - place))[inside], rtol=0, atol=2.5e-5
    )
    assert found.displacement[k][place > time[k] + 0.02].isnan().all()
    # Half of the area lies within t / sqrt 2.
    assert found.area_median[k].item() == pytest.approx(0.02 * (2 - 3 / math.sqrt(2)) * time[k].item(), abs=3e-4)
    # Over the disc of radius s: 2 u / s = 2 c (t - s).
    assert found.mean_within(0.5)[k].item() == pytest.approx(0.02 * time[k].item(), abs=3e-4)


def test_a_press_with_more_friction_spreads_less_since_the_onset() -> None:
    time = torch.linspace(0, 0.5, 33, dtype=torch.float64)
    pressed = follow(
        torch.tensor([0.05, 0.2, 1.0]), time, 5.0 * (time / 0.5)[:, None].expand(-1, 3), parameters="paper", elements=51
    )
    found = since_onset(pressed)
    assert (found.mean_within(0.6)[-1].diff() < 0).all()
    assert found.area_median[0].isnan().all()
    # The element on the axis touches first, and has no neighbour from which to compute a gradient.
    assert since_onset(follow(0.2, time[:2], 0.004, elements=51)).area_median.isnan().all()
    assert found.contact_area[-1].sub(math.pi / 4 * pressed.contact_length[-1].square()).abs().max() < 1e-15


def test_what_is_no_finger_of_revolution_is_refused() -> None:
    time = torch.tensor([0.0, 0.05, 0.1], dtype=torch.float64)
    pulled = follow(0.5, time, 2.0, tangential_n=torch.tensor([0.0, 0.2, 0.4], dtype=torch.float64), elements=41)
    with pytest.raises(ValueError, match="off its axis"):
        since_onset(pulled)
