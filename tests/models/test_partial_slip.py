"""Tests of the partial-slip model: both directions, the branch that loading follows, limits, and the
paper's misprints.
"""

import pytest
import torch
from scipy.integrate import quad

from fingerflow.models import partial_slip

# mu_k below mu_s, 0, equal to mu_s, just below, above, at and beyond 2 mu_s, and little below a large mu_s.
FRICTION = [(0.8, 0.5), (0.8, 0.0), (0.8, 0.8), (0.8, 0.8 * (1 - 1e-9)), (0.8, 1.2), (0.8, 1.6), (0.8, 2.4), (3.0, 2.9)]


def smallest_area(mu_s: float, mu_k: float) -> float:
    return max(float(partial_slip.critical_stuck_area(mu_s, mu_k).nan_to_num(0.0)), 0.0)


@pytest.mark.parametrize(("mu_s", "mu_k"), FRICTION)
def test_area_and_load_are_inverse_along_the_larger_root(mu_s: float, mu_k: float) -> None:
    """Load to area to load returns the load to 1e-12. Area to load to area returns the area to 1e-12; where the load
    hardly depends on the area, to the rounding of the load in float64. The area falls from 1 to the critical one, and
    there is none beyond the critical load or below 0.
    """
    largest, smallest = partial_slip.critical_load_ratio(mu_s, mu_k), smallest_area(mu_s, mu_k)
    loads = torch.cat([torch.logspace(-15, 0, 200, dtype=torch.float64), torch.linspace(0, 1, 2001).double()]) * largest
    areas = partial_slip.stuck_area(loads, mu_s, mu_k)
    assert areas.isfinite().all()
    torch.testing.assert_close(partial_slip.load_ratio(areas, mu_s, mu_k), loads, atol=1e-12 * largest.item(), rtol=0)
    rising = areas[200:]
    assert rising[0] == 1
    assert (rising.diff() < 0).all()
    assert rising[-1].item() == pytest.approx(smallest, abs=2e-7)
    outside = torch.tensor([-1e-9, 1 + 1e-9, 2, 50.0, torch.nan], dtype=torch.float64) * largest
    assert partial_slip.stuck_area(outside, mu_s, mu_k).isnan().all()

    areas = smallest + (1 - smallest) * torch.linspace(0, 1, 2001, dtype=torch.float64)
    back = partial_slip.stuck_area(partial_slip.load_ratio(areas, mu_s, mu_k), mu_s, mu_k)
    slope = 2 * ((2 * mu_s - mu_k) * areas - (mu_s - mu_k)).abs()
    assert ((back - areas).abs() <= 1e-12 + 1e-15 * max(mu_s, mu_k) / slope.clamp(min=1e-7)).all()
    inner = areas > smallest + 1e-2
    torch.testing.assert_close(back[inner], areas[inner], atol=1e-12, rtol=0)


def test_a_minimal_area_needs_more_static_than_kinetic_friction() -> None:
    """A critical area exists only if static friction exceeds kinetic friction; the abstract states the reverse."""
    assert partial_slip.critical_stuck_area(0.8, 0.5).item() == pytest.approx(0.3 / 1.1)
    assert partial_slip.critical_stuck_area(0.8, 0.8) == 0
    assert partial_slip.critical_stuck_area(0.8, 0.0) == 0.5
    assert partial_slip.critical_stuck_area(0.5, 0.8).isnan()
    assert partial_slip.critical_stuck_area(0.8, 1.6).isnan()


@pytest.mark.parametrize(("mu_s", "mu_k"), [(0.8, 0.5), (0.8, 1.3), (0.7, 0.0)])
@pytest.mark.parametrize("area", [0.0, 0.11, 0.36, 0.9, 1.0])
def test_the_traction_adds_up_to_the_load(area: float, mu_s: float, mu_k: float) -> None:
    """The traction integrates to the load: mu_s times the pressure at the border inside the stick region, mu_k p around
    it, under the pressure (2 N / A) (1 - r^2).
    """
    inside, _ = quad(lambda r: mu_s * 2 * (1 - area) * 2 * r, 0, area**0.5)
    around, _ = quad(lambda r: mu_k * 2 * (1 - r * r) * 2 * r, area**0.5, 1)
    assert partial_slip.load_ratio(area, mu_s, mu_k).item() == pytest.approx(inside + around, abs=1e-9)


@pytest.mark.parametrize("mu_k", [0.0, 0.5, 0.8, 1.6, 2.0])
def test_gradients(mu_k: float) -> None:
    load = torch.tensor([0.05, 0.2, 0.35], dtype=torch.float64, requires_grad=True)
    friction = [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in (0.8, max(mu_k, 0.01))]
    assert torch.autograd.gradcheck(partial_slip.stuck_area, (load, *friction))
    assert torch.autograd.gradcheck(partial_slip.load_ratio, (load, *friction))
    if mu_k < 0.8:
        assert torch.autograd.gradcheck(partial_slip.critical_stuck_area, friction)
        assert torch.autograd.gradcheck(partial_slip.friction_ratio, (load,))


def test_a_load_that_no_area_carries_leaves_the_gradient_of_the_others_alone() -> None:
    load = torch.tensor([0.2, 5.0, -1.0], dtype=torch.float64, requires_grad=True)
    static = torch.tensor(0.8, dtype=torch.float64, requires_grad=True)
    partial_slip.stuck_area(load, static, 0.5).nansum().backward()
    assert load.grad is not None
    assert static.grad is not None
    assert load.grad[0] < 0
    assert (load.grad[1:] == 0).all()
    assert static.grad > 0


def test_friction_that_cannot_be() -> None:
    with pytest.raises(ValueError, match=r"mu_s is 0: .* above 0"):
        partial_slip.stuck_area(0.1, 0.0, 0.5)
    with pytest.raises(ValueError, match=r"mu_k is -0.1: .* 0 or more"):
        partial_slip.load_ratio(0.1, 0.5, -0.1)
