"""Tests of the bound of mu_k / mu_s against the scatter and shift of fits to drawn d²(T/N)."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import least_squares

from bench.friction_bound import friction_bound
from bench.suites.slip import trial
from fingerflow.models.partial_slip import stuck_area

SEED = 102  # critical area of 0.36


def test_fits_scatter_and_shift_by_the_bound() -> None:
    """Fits scatter and shift as the bound states, for noise so small that the model is linear; 150 draws tell a
    deviation to 6 %, and four times that is allowed.
    """
    known = trial(SEED)
    known = replace(known, force_noise=0.0)
    noise, offset = 2e-4, 2e-4
    bound = friction_bound(known, noise, offset)
    progress = np.asarray(known.progress(known.times))
    load = known.motion.load_ratio(torch.as_tensor(progress[progress < known.motion.loaded])).double()
    truth = stuck_area(load, known.static_friction, known.kinetic_friction).numpy()
    seen = (load.numpy() > 0) & np.isfinite(truth)
    load, truth = load[torch.from_numpy(seen)], truth[seen]
    draw = np.random.default_rng(0)

    def ratio(measured: np.ndarray) -> float:
        def left(friction: np.ndarray) -> np.ndarray:
            return np.nan_to_num(stuck_area(load, *friction.tolist()).numpy(), nan=0.0) - measured

        start = [known.static_friction, known.kinetic_friction]
        fitted = least_squares(left, start, x_scale=1e-3, method="lm").x
        return float(fitted[1] / fitted[0]) / (start[1] / start[0]) - 1

    found = np.array([ratio(truth + noise * draw.standard_normal(len(truth))) for _ in range(150)])
    assert np.std(found) == pytest.approx(bound.deviation, rel=0.24)
    assert ratio(truth + offset) == pytest.approx(bound.shift, rel=0.1)
