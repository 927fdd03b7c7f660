"""Tests of displacement fields that vanish at the border: normal equations by moments, prior scale by search."""

import numpy as np
import pytest
from numpy.typing import NDArray

from fingerflow.pipeline.stages.strain import border_field
from fingerflow.pipeline.stages.strain.border_field import BorderFunctions

Array = NDArray[np.float64]
FUNCTIONS = BorderFunctions()


def functions_at(places: Array) -> Array:
    """Return the K functions (N, K) at positions (2, N)."""
    i, j = FUNCTIONS._powers
    x, y = places[:, :, None]
    return (1 - x**2 - y**2) * ((x**i * y**j) @ FUNCTIONS._mixed)


def one_fit(numbers: int, noise: float, size: float, seed: int) -> tuple[Array, Array, Array]:
    """Return positions (2, N) in the disc, displacements (2, N) of a smooth field with noise, and weights (N,), some of
    them 0.
    """
    random = np.random.default_rng(seed)
    radius, turn = np.sqrt(random.uniform(0, 0.95, numbers)), random.uniform(0, 2 * np.pi, numbers)
    places = radius * np.stack((np.cos(turn), np.sin(turn)))
    coefficients = size * random.standard_normal((FUNCTIONS._mixed.shape[1], 2))
    std = noise * random.uniform(0.5, 2, numbers)
    moved = (functions_at(places) @ coefficients).T + std * random.standard_normal((2, numbers))
    return places, moved, np.where(random.uniform(size=numbers) < 0.9, std**-2.0, 0)


@pytest.mark.parametrize(
    ("numbers", "noise", "size"), [(500, 1e-3, 1.0), (60, 1e-3, 3.0), (30, 1e-2, 0.3), (500, 0.1, 0.1)]
)
def test_fit_is_that_of_the_mean_scale(numbers: int, noise: float, size: float) -> None:
    """Coefficients and covariance agree to 1e-8 with a solution by eigenvalues, with the functions evaluated at the
    points, at the posterior root mean square of the scale; noise is that at the most likely scale.

    Sums of monomials of degree 16 are multiplied by the square of the inverse Gram matrix, which limits the agreement.
    """
    each = [one_fit(numbers, noise, size, seed) for seed in range(10)]
    found = FUNCTIONS.fit(*(np.stack(one) for one in zip(*each, strict=True)))
    for k, (places, moved, weight) in enumerate(each):
        known = weight > 0
        root = np.sqrt(weight[known])
        functions, weighed = root[:, None] * functions_at(places[:, known]), (root * moved[:, known]).T
        squares, turned = np.linalg.eigh(functions.T @ functions)
        seen, scales = turned.T @ functions.T @ weighed, border_field._SCALES
        shrunk = 1 + scales[:, None] * squares.clip(0)
        rest = (weighed**2).sum() - scales * (seen**2 / shrunk[..., None]).sum((1, 2))
        spread = np.maximum(rest / weighed.size, 1)
        likelihood = -weighed.size * np.log(spread) - 2 * np.log(shrunk).sum(1) - rest / spread
        scale = np.average(scales, weights=np.exp((likelihood - likelihood.max()) / 2) * np.sqrt(scales))
        inverse = (turned * scale / (1 + scale * squares.clip(0))) @ turned.T
        coefficients, covariance = inverse @ functions.T @ weighed, spread[likelihood.argmax()] * inverse
        np.testing.assert_allclose(found.coefficients[k], coefficients, atol=1e-8 * abs(coefficients).max())
        np.testing.assert_allclose(found.covariance[k], covariance, atol=1e-8 * abs(covariance).max())


def test_a_field_that_moves_at_the_border() -> None:
    """A translation, a rotation and a shear of all skin are found exactly from noise-free points, by coefficients whose
    gradients are those of the motion.
    """
    random = np.random.default_rng(4)
    places = np.sqrt(random.uniform(0, 0.9, 200)) * np.stack(
        (np.cos(turns := random.uniform(0, 7, 200)), np.sin(turns))
    )
    gradient = np.array([[0.02, -0.05], [0.03, 0.01]])
    moved = gradient @ places + np.array([[0.1], [-0.2]])
    found = FUNCTIONS.fit(places[None], moved[None], np.full((1, 200), 1e12), np.array([0.2]))
    slopes = np.einsum("dpk,kc->pcd", FUNCTIONS.gradient, found.coefficients[0])
    np.testing.assert_allclose(slopes, np.broadcast_to(gradient, slopes.shape), atol=1e-6)
    assert found.noise == 1


@pytest.mark.parametrize("numbers", [3, 30])
def test_few_points_of_unequal_errors_have_a_field(numbers: int) -> None:
    """Three or thirty points, one three million times more exact than the rest, have finite coefficients: rounding
    leaves the normal equations positive definite at every prior scale.
    """
    each = [one_fit(numbers, 1e-2, 0.3, seed) for seed in range(20)]
    places, moved, weight = (np.stack(one) for one in zip(*each, strict=True))
    weight[:, 0] = 1e17
    found = FUNCTIONS.fit(places, moved, weight)
    assert np.isfinite(found.coefficients).all()
    assert np.isfinite(found.covariance).all()
