"""Tests of a trial driven by its load: stuck area, load and truth are those of the model."""

import numpy as np
import pytest
import torch

from fingerflow.models.partial_slip import critical_load_ratio, stuck_area
from fingerflow.synthetic import Ellipse, PartialSlip

ABRUPT = PartialSlip()
FADING = PartialSlip(static_friction=0.6, kinetic_friction=0.8)
TRIALS = pytest.mark.parametrize("trial", [ABRUPT, FADING], ids=["abrupt", "fading"])


@TRIALS
def test_the_stuck_area_is_what_the_load_leaves(trial: PartialSlip) -> None:
    area = np.array([trial.stuck_share(frame) for frame in range(trial.n_frames)])
    load = trial.tangential_force(trial.times) / trial.force
    friction = trial.static_friction, trial.kinetic_friction
    end = trial.full_slip - (0.2 / trial.times[-1] if trial is ABRUPT else 0)
    loading = trial.progress(trial.times) < end
    assert loading.sum() > 200
    # Rounding of the load (1e-16) is amplified by the square root near the critical load.
    np.testing.assert_allclose(area[loading], stuck_area(load[loading], *friction), rtol=0, atol=1e-12)
    assert load.max() == pytest.approx(float(critical_load_ratio(*friction)))
    assert load[-1] == pytest.approx(trial.kinetic_friction)


@TRIALS
@pytest.mark.parametrize("frame", [60, 200])
def test_skin_moves_outside_of_the_stuck_ellipse_alone(trial: PartialSlip, frame: int) -> None:
    truth, share = trial.truth, trial.stuck_share(frame)
    assert 0 < share < 1
    ellipse = truth.ellipse(frame)
    assert ellipse is not None
    stuck = Ellipse(ellipse.centre, tuple(np.sqrt(share) * np.array(ellipse.semi_axes)), ellipse.angle)  # type: ignore[arg-type]
    x, y = np.meshgrid(*(middle + np.linspace(-5, 5, 201) for middle in ellipse.centre))
    radius = stuck.radius(torch.from_numpy(x), torch.from_numpy(y)).numpy()
    moved = np.linalg.norm(np.stack((x, y), -1) - truth.material(np.stack((x, y), -1), frame), axis=-1)
    assert (moved[radius < 0.999] == 0).all()
    assert (moved[radius > 1.001] > 0).all()
    # The displacement has no step at the border, and skin does not fold.
    assert np.abs(np.diff(moved, axis=1)).max() < 0.5 * 0.05


def test_jumps_carry_contact_and_skin_together() -> None:
    jumping = PartialSlip(jumps=(3.79, 4.19))
    at = [int(np.searchsorted(jumping.times, time)) for time in jumping.jumps]
    for frame, number in ((at[0] - 1, 0), (at[0], 1), (at[1] - 1, 1), (at[1], 2), (299, 2)):
        ellipse, plain = jumping.truth.ellipse(frame), ABRUPT.truth.ellipse(frame)
        assert ellipse is not None
        assert plain is not None
        gone = np.subtract(ellipse.centre, plain.centre)
        np.testing.assert_allclose(gone, number * 0.1625 * np.array(jumping.way), atol=1e-9)
        skin = jumping.truth.material(np.array(ellipse.centre), frame)
        np.testing.assert_allclose(skin, ABRUPT.truth.material(np.array(plain.centre), frame), atol=1e-9)
