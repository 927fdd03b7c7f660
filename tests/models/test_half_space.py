"""Tests of stress at depth against closed forms in 60 digits and equilibrium, and of each published error."""

import math

import mpmath
import pytest
import torch
from torch import Tensor

from fingerflow.models.half_space import stress

PLACES = [0.0, 0.1, 0.4999, 0.5, 0.6, 3.0, -70.0]  # in strip widths from the middle
DEPTHS = [1e-6, 1e-3, 0.1, 1.0, 2.1, 10.0, 300.0]
STRIP = torch.tensor([-0.5, 0.5], dtype=torch.float64)
ONE, NONE = torch.ones(1, dtype=torch.float64), torch.zeros(1, dtype=torch.float64)


def tensor(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def strip_exactly(y: float, z: float, load: str) -> list[float]:
    """Return the stresses under a load of 1 on -1/2 to 1/2 by antiderivatives of the four kernels."""
    with mpmath.workdps(60):
        y, z = mpmath.mpf(y), mpmath.mpf(z)
        # Antiderivatives of 2 r^k z^(3-k) / R^4, k = 0 to 3.
        primitives = [
            lambda r: r * z / (r * r + z * z) + mpmath.atan(r / z),
            lambda r: -z * z / (r * r + z * z),
            lambda r: mpmath.atan(r / z) - r * z / (r * r + z * z),
            lambda r: mpmath.log(r * r + z * z) + z * z / (r * r + z * z),
        ]
        kernels = [primitive(y + 0.5) - primitive(y - 0.5) for primitive in primitives]
        powers = {"pressure": (2, 0, 1), "traction": (3, 1, 2)}[load]
        return [float(-kernels[k] / mpmath.pi) for k in powers]


@pytest.mark.parametrize("load", ["pressure", "traction"])
@pytest.mark.parametrize("z", DEPTHS)
def test_a_uniform_strip_to_12_digits(z: float, load: str) -> None:
    loads = (ONE, NONE) if load == "pressure" else (NONE, ONE)
    for y in PLACES:
        found = [part.item() for part in stress(y, z, STRIP, *loads)]
        assert found == pytest.approx(strip_exactly(y, z, load), rel=1e-12, abs=0), y


def test_batches_and_depth_maps_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loads (time, set, M) on moving edges give the same stresses at a map of positions in one piece and in many."""
    generator = torch.Generator().manual_seed(2)
    edges = torch.rand(4, 1, 6, generator=generator, dtype=torch.float64).cumsum(-1)
    pressure = torch.rand(4, 3, 5, generator=generator, dtype=torch.float64)
    y, z = torch.linspace(0, 3, 7)[:, None], torch.linspace(0.1, 2, 5)
    whole = stress(y, z, edges, pressure).sigma_y
    assert whole.shape == (4, 3, 7, 5)
    one = stress(y[4], z[2], edges[1, 0], pressure[1, 2]).sigma_y
    assert whole[1, 2, 4, 2].item() == pytest.approx(one.item(), rel=1e-13)
    monkeypatch.setattr("fingerflow.models.half_space._PAIRS_AT_ONCE", 100)
    torch.testing.assert_close(stress(y, z, edges, pressure).sigma_y, whole, rtol=1e-14, atol=0)


LOADED = (tensor(-1.0, -0.2, 0.3, 1.5), tensor(1.0, 0.4, 2.0), tensor(-0.5, 0.2, 0.9))


def test_stress_is_in_equilibrium() -> None:
    """Stresses satisfy d sigma_y / dy + d tau / dz = 0 and d tau / dy + d sigma_z / dz = 0, by differences of fourth
    order.
    """
    y, z = torch.linspace(-2, 2, 23, dtype=torch.float64)[:, None], torch.linspace(0.3, 3, 7, dtype=torch.float64)
    step = 1e-3

    def slope(component: int, dy: float, dz: float) -> Tensor:
        def at(k: int) -> Tensor:
            return stress(y + k * step * dy, z + k * step * dz, *LOADED)[component]

        return (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * step)

    for left, right in ((slope(0, 1, 0), slope(2, 0, 1)), (slope(2, 1, 0), slope(1, 0, 1))):
        assert left.abs().max() > 0.1
        torch.testing.assert_close(left, -right, rtol=0, atol=1e-9)


def test_below_a_hertzian_line_contact() -> None:
    """Stresses on the axis under p0 sqrt(1 - s^2 / a^2), from 4000 strips, equal Johnson's equations 4.45."""
    edges = torch.sin(torch.linspace(-math.pi / 2, math.pi / 2, 4001, dtype=torch.float64))
    pressure = (1 - ((edges[1:] + edges[:-1]) / 2) ** 2).sqrt()
    z = torch.tensor([0.05, 0.5, 0.78, 2.0, 10.0], dtype=torch.float64)
    found = stress(0.0, z, edges, pressure)
    root = (1 + z * z).sqrt()
    torch.testing.assert_close(found.sigma_y, -((1 + 2 * z * z) / root - 2 * z), rtol=1e-5, atol=1e-8)
    torch.testing.assert_close(found.sigma_z, -1 / root, rtol=1e-6, atol=0)
    assert found.tau_yz.abs().max() < 1e-12
    deep = torch.linspace(0.7, 0.9, 201, dtype=torch.float64)
    largest = stress(0.0, deep, edges, pressure)
    difference = (largest.sigma_y - largest.sigma_z).abs() / 2
    assert difference.max().item() == pytest.approx(0.30, abs=1e-3)  # at 0.78 a
    assert deep[difference.argmax()].item() == pytest.approx(0.78, abs=0.01)


def test_differentiable() -> None:
    y = tensor(-3.0, 0.2, 0.5, 40.0).requires_grad_()
    z = tensor(0.3, 1.0, 5.0, 2.0).requires_grad_()
    edges = tensor(-0.5, 0.1, 0.7).requires_grad_()
    pressure, traction = tensor(1.0, 2.0).requires_grad_(), tensor(0.3, -0.4).requires_grad_()

    assert torch.autograd.gradcheck(stress, (y, z, edges, pressure, traction))


@pytest.mark.parametrize(
    ("y", "z", "edges", "pressure", "match"),
    [
        (0.0, 0.0, STRIP, ONE, "z > 0"),
        (0.0, -1.0, STRIP, ONE, "z > 0"),
        (math.nan, 1.0, STRIP, ONE, "z > 0"),
        (0.0, 1.0, STRIP.flip(0), ONE, "rise"),
        (0.0, 1.0, STRIP, torch.ones(2), "one value a strip"),
        (0.0, 1.0, STRIP, ONE * math.nan, "not finite"),
    ],
)
def test_bad_input_is_refused(y: float, z: float, edges: Tensor, pressure: Tensor, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        stress(y, z, edges, pressure)
