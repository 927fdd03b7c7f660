"""Tests of the natural Helmholtz-Hodge decomposition on fields whose parts are known in closed form."""

import pytest
import torch
from torch import Tensor

from fingerflow.ops import helmholtz_hodge


def grid(pixels: int, half: float = 2.0) -> tuple[Tensor, Tensor, float]:
    """Return x and y (pixels, pixels), float64, of the pixel centres of a square from -half to half, and the pixel
    size.
    """
    size = 2 * half / pixels
    axis = (torch.arange(pixels, dtype=torch.float64) + 0.5) * size - half
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    return x, y, size


def blob(x: Tensor, y: Tensor, width: float = 0.35) -> Tensor:
    """Return the radial flow (1, 2, H, W) of a Gaussian source of this width: (1 - exp(-r^2 / 2 w^2)) x / r^2."""
    squared = x.square() + y.square()
    share = -torch.expm1(-squared / (2 * width**2)) / squared
    return torch.stack((share * x, share * y))[None]


def turned(field: Tensor) -> Tensor:
    """Return a field (1, 2, H, W) with its vectors rotated by a right angle, which turns a source into a vortex."""
    return torch.stack((-field[:, 1], field[:, 0]), 1)


def test_a_source_is_irrotational_and_a_vortex_solenoidal() -> None:
    """A source is irrotational and a vortex solenoidal to 1 % of the largest speed with 64 pixels (11 per width); with
    128 pixels the error falls to less than a third, as an error of second order does.
    """
    errors = []
    for pixels in (64, 128):
        x, y, _ = grid(pixels)
        source = blob(x, y)
        largest = source.abs().max()
        parts = helmholtz_hodge(source)
        errors.append(float((parts.irrotational - source).abs().max() / largest))
        # A source has no curl but the error of the central differences.
        assert parts.solenoidal.abs().max() < 0.01 * largest
        swirl = helmholtz_hodge(turned(source))
        torch.testing.assert_close(swirl.solenoidal, turned(parts.irrotational), rtol=0, atol=1e-12)
    assert errors[0] < 0.01
    assert errors[1] < errors[0] / 3


@pytest.mark.parametrize("name", ["translation", "saddle", "higher"])
def test_a_harmonic_field_is_harmonic(name: str) -> None:
    """Fields without divergence and curl are entirely harmonic. Central differences are exact inside for these
    polynomials; one-sided differences at the border leave an error of first order for "higher".
    """
    x, y, size = grid(48)
    fields = {
        "translation": (torch.ones_like(x), -2 * torch.ones_like(x)),
        "saddle": (x, -y),
        "higher": (x.square() - y.square(), -2 * x * y),
    }
    field = torch.stack(fields[name])[None]
    parts = helmholtz_hodge(field)
    # One-sided differences at the border of the frame have an error of first order.
    limit = 1e-12 if name != "higher" else 2 * size
    assert parts.irrotational.abs().max() <= limit
    assert parts.solenoidal.abs().max() <= limit
    torch.testing.assert_close(parts.harmonic, field, rtol=0, atol=max(2 * limit, 1e-12))


def test_nothing_outside_the_mask_matters() -> None:
    x, y, _ = grid(48)
    inside = (x.square() / 2 + y.square() < 1)[None, None]
    field = blob(x - 0.2, y) + turned(blob(x, y + 0.3))
    other = torch.where(inside, field, 1e6)
    broken = torch.where(inside, field, torch.nan)
    for found, again, unknown in zip(
        helmholtz_hodge(field, inside), helmholtz_hodge(other, inside), helmholtz_hodge(broken), strict=True
    ):
        torch.testing.assert_close(found, again, rtol=0, atol=0, equal_nan=True)
        torch.testing.assert_close(found, unknown, rtol=0, atol=0, equal_nan=True)
