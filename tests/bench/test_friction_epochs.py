"""Tests of friction epochs on a simulated tribometer: the selected half periods, and the known coefficient."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from bench.papers.friction_epochs import friction_epochs

EDGES = 1e-6 * torch.tensor([-0.1, 0.5, 1.0, 1.5, 2.0, 2.5, 3.1])  # the envelope is noisy, also below 0
Trace = dict[str, Tensor]


def trace(rate: float = 2000.0, noise: float = 0.02, seconds: float = 8.0) -> Trace:
    """Return signals of strokes of 2 s to the left and to the right with mu = 0.9 - 0.2 amplitude / um where the
    envelope rises.

    Where the envelope falls and on strokes to the right friction is different, and must not be used.
    """
    generator = np.random.default_rng(5)
    time = np.arange(round(rate * seconds)) / rate
    phase = 2 * math.pi * 4 * time + 1.0
    amplitude = 1.5e-6 * (1 - np.cos(phase))
    rising = np.sin(phase) > 0
    leftwards = time % 4 < 2
    stroke = time % 2
    position = np.where(leftwards, 0.1 - 0.05 * stroke, 0.05 * stroke)
    mu = 0.9 - 0.2e6 * amplitude + 0.3 * ~rising + 0.5 * ~leftwards
    normal = 0.5 + 0.05 * np.sin(3 * time)
    tangential = np.where(leftwards, 1, -1) * mu * normal
    signals = {
        "normal": normal + noise * 0.02 * generator.standard_normal(len(time)),
        "tangential": tangential + noise * generator.standard_normal(len(time)) * 0.5,
        "position": position + 1e-6 * generator.standard_normal(len(time)),
        "amplitude": amplitude + 2e-8 * generator.standard_normal(len(time)),
    }
    return {name: torch.from_numpy(values) for name, values in {"time": time, **signals}.items()}


def friction_at_the_bins() -> list[float]:
    """Return the friction coefficient at the middle of each bin, within the range of the envelope (0 to 3 um)."""
    edges = np.clip(EDGES.numpy(), 0, 3e-6)
    return [float(mu) for mu in 0.9 - 0.1e6 * (edges[1:] + edges[:-1])]


def test_the_coefficient_falls_with_the_amplitude() -> None:
    """Of the 14 rising halves of the envelope on strokes to the left that cross no turn."""
    found = friction_epochs(**trace(), edges=EDGES)
    median, spread, epochs = found.over_epochs()
    assert median.tolist() == pytest.approx(friction_at_the_bins(), abs=0.006)
    assert bool((spread < 0.03).all())
    assert epochs.tolist() == [14] * 6
    assert found.median.shape == (14, 6)


def test_the_sinusoid_does_not_bias_the_bins() -> None:
    """The sinusoidal envelope does not bias the bins: the envelope dwells at its ends, where the value at the middle
    phase of a bin is 0.024 off.
    """
    edges = torch.linspace(0, 3.0001e-6, 7, dtype=torch.float64)
    middles = 1e6 * (edges[1:] + edges[:-1]) / 2
    exact = trace(noise=0.0)
    for law in (lambda um: 0.9 - 0.2 * um, lambda um: 0.9 * np.exp(-0.5 * um)):
        exact["tangential"] = torch.from_numpy(law(1e6 * exact["amplitude"].numpy())) * exact["normal"]
        median, _, _ = friction_epochs(**exact, edges=edges).over_epochs()
        assert median.tolist() == pytest.approx(law(middles.numpy()).tolist(), abs=2e-3)
