"""Windows compared, and the deformation that makes them alike."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from fingerflow.engines.together import Call, Steps, run_alone
from fingerflow.ops.tracking.window_correlation import sample_windows
from fingerflow.tracker.windows import Sampler, correlation, deformed_alike

Array = NDArray[Any]

WINDOW, STEP = 25, 3
GRADIENT = np.array([[0.02, -0.01], [0.015, -0.02]], np.float32)


def test_correlation_is_that_of_numpy() -> None:
    random = np.random.default_rng(0)
    one, other = random.normal(100, 20, (2, 30, 81)).astype(np.float32)
    expected = [np.corrcoef(*pair)[0, 1] for pair in zip(one, other, strict=True)]
    np.testing.assert_allclose(correlation(one, other), expected, rtol=0, atol=1e-5)
    np.testing.assert_allclose(correlation(one, 3 * one - 20), 1, rtol=0, atol=1e-5)
    assert np.isnan(correlation(one, np.full_like(one, 3.0))).all()


def test_a_deformation_is_found_with_the_middle_held() -> None:
    """From none, to 0.01 in each number; a window beyond the picture keeps the deformation it had."""
    y, x = np.mgrid[:160, :200].astype(np.float64)
    inverse = np.linalg.inv(np.eye(2) + GRADIENT)
    before, after = texture(x, y), texture(*np.moveaxis(np.stack((x, y), -1) @ inverse.T, -1, 0))
    then = np.random.default_rng(1).uniform((30, 30), (160, 120), (40, 2)).astype(np.float32)
    now = (then @ (np.eye(2) + GRADIENT).T).astype(np.float32)
    now[7] = (3, 3)
    number, straight = np.zeros(40, np.int64), np.broadcast_to(np.eye(2, dtype=np.float32), (40, 2, 2))
    first = sampler(before)(number, then, straight)
    found = run_alone(deformed_alike(first, called(sampler(after)), number, now, straight, WINDOW, STEP))
    assert np.array_equal(found[7], np.eye(2))
    near = np.abs(found - np.eye(2) - GRADIENT)[np.arange(40) != 7]
    assert near.max() < 0.01


def texture(x: Array, y: Array) -> Array:
    """Waves of 9 px and more in several directions, float32."""
    waves = [np.sin((np.cos(turn) * x + np.sin(turn) * y) * 2 * np.pi / (9 + 2 * turn) + turn) for turn in range(6)]
    result: Array = (120 + 15 * np.sum(waves, axis=0)).astype(np.float32)
    return result


def sampler(image: Array) -> Any:
    def sample(number: Array, places: Array, warp: Array) -> Array:
        given = [torch.from_numpy(np.ascontiguousarray(one)) for one in (image[None, None], number, places, warp)]
        return sample_windows(given[0], given[1], given[2], given[3], WINDOW, STEP).numpy()

    return sample


def called(sample: Any) -> Sampler:
    def steps(*given: Array) -> Steps[Array]:
        found: Array = yield Call(sample, given)
        return found

    return steps
