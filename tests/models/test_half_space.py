"""Tests of stress at depth against closed forms in 60 digits and equilibrium, and of each published error."""

import math

import mpmath
import pytest
import torch
from torch import Tensor

from fingerflow.models.half_space import stress

PLACES = [0.0, 0.4999, 0.5, 3.0, -70.0]  # in strip widths from the middle
DEPTHS = [1e-6, 0.1, 1.0, 300.0]
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
    whole, _, _ = stress(y, z, edges, pressure)
    assert whole.shape == (4, 3, 7, 5)
    one, _, _ = stress(y[4], z[2], edges[1, 0], pressure[1, 2])
    assert whole[1, 2, 4, 2].item() == pytest.approx(one.item(), rel=1e-13)
    monkeypatch.setattr("fingerflow.models.half_space._PAIRS_AT_ONCE", 100)
    torch.testing.assert_close(stress(y, z, edges, pressure)[0], whole, rtol=1e-14, atol=0)


def test_differentiable() -> None:
    # At the last point z^2 is the product of the distances from the first two edges: Sigma is a right angle.
    y = tensor(-3.0, 0.2, 0.5, 40.0, 0.625).requires_grad_()
    z = tensor(0.3, 1.0, 5.0, 2.0, 0.75).requires_grad_()
    edges = tensor(-0.5, 0.125, 0.7).requires_grad_()
    pressure, traction = tensor(1.0, 2.0).requires_grad_(), tensor(0.3, -0.4).requires_grad_()

    assert torch.autograd.gradcheck(stress, (y, z, edges, pressure, traction))


@pytest.mark.parametrize(
    ("y", "z", "edges", "pressure", "match"),
    [
        (0.0, 0.0, STRIP, ONE, "z > 0"),
        (math.nan, 1.0, STRIP, ONE, "z > 0"),
        (0.0, 1.0, STRIP.flip(0), ONE, "rise"),
        (0.0, 1.0, STRIP, torch.ones(2), "one value a strip"),
        (0.0, 1.0, STRIP, ONE * math.nan, "not finite"),
    ],
)
def test_bad_input_is_refused(y: float, z: float, edges: Tensor, pressure: Tensor, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        stress(y, z, edges, pressure)
