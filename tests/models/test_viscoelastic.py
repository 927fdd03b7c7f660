"""Tests of the delayed strain against closed solutions, with small and large steps."""

import math

import pytest
import torch

from fingerflow.models.viscoelastic import viscoelastic_strain

E, RATE, NU = 1.1e6, 100.0, 0.4


@pytest.mark.parametrize("step", [1e-9, 3e-3, 0.5])
def test_a_ramp_of_stress_exactly(step: float) -> None:
    """A ramp sigma_y = c t gives e = c / E (t - tau (1 - exp(-t / tau))) along y and -nu times that across, whatever
    the step, for each of two moduli of one stress.
    """
    time, modulus = step * torch.arange(9, dtype=torch.float64), torch.tensor([2 * E, E])
    along_y, along_z = viscoelastic_strain(5e3 * time, 0 * time, time, young_modulus=modulus)
    expected = [5e3 / E * _lag(float(t)) for t in time]
    assert (2 * along_y[:, 0]).tolist() == pytest.approx(expected, rel=1e-12, abs=0)
    assert along_z[:, 1].tolist() == pytest.approx([-NU * value for value in expected], rel=1e-12, abs=0)


def _lag(time: float) -> float:
    x = RATE * time
    if x < 1e-2:
        return sum((-1) ** k * x**k / math.factorial(k) for k in range(2, 9)) / RATE
    return time + math.expm1(-x) / RATE


def test_the_corner_is_at_16_hz_and_not_at_100() -> None:
    """The gain falls to 1 / sqrt 2 at 100 / (2 pi) Hz, and to a sixth at the printed corner of 100 Hz."""
    for frequency, gain in ((RATE / (2 * math.pi), 1 / math.sqrt(2)), (100.0, 1 / math.hypot(1, 2 * math.pi))):
        time = torch.linspace(0, 0.3, 6001, dtype=torch.float64)
        stress = torch.sin(2 * math.pi * frequency * time)
        strain = E * viscoelastic_strain(stress, 0 * stress, time)[0]
        assert strain[time > 0.2].max().item() == pytest.approx(gain, rel=1e-3)


def test_differentiable() -> None:
    time = torch.tensor([0.0, 1e-3, 0.02], dtype=torch.float64)
    stress = torch.tensor([[2.0, 1.0], [0.3, 1.2], [1.0, 0.1]], dtype=torch.float64, requires_grad=True)
    rate = torch.tensor([[1.7], [0.9]], dtype=torch.float64, requires_grad=True)

    def strain(stress: torch.Tensor, rate: torch.Tensor) -> torch.Tensor:
        return viscoelastic_strain(stress, stress**2, time, young_modulus=2.0, rate=100 * rate)[0]

    assert torch.autograd.gradcheck(strain, (stress, rate))


def test_wrong_times_shapes_and_rates_are_refused() -> None:
    time, stress = torch.tensor([0.0, 1.0, 1.0]), torch.zeros(3, 2)
    with pytest.raises(ValueError, match=r"smallest step of 0\.0 s"):
        viscoelastic_strain(stress, stress, time)
    with pytest.raises(ValueError, match=r"give \(T, \.\.\.\)"):
        viscoelastic_strain(stress, stress[:2], time[:2])
    with pytest.raises(ValueError, match=r"rate 0\.0 1/s"):
        viscoelastic_strain(stress[:2], stress[:2], time[:2], rate=0.0)
