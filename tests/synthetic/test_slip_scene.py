"""Tests of a trial driven by its load: stuck area, load and truth are those of the model."""

import math

import numpy as np
import pytest
import torch

from fingerflow.models.partial_slip import critical_load_ratio, critical_stuck_area, stuck_area
from fingerflow.synthetic import Ellipse, PartialSlip

ABRUPT = PartialSlip()
FADING = PartialSlip(static_friction=0.6, kinetic_friction=0.8)
TRIALS = pytest.mark.parametrize("trial", [ABRUPT, FADING], ids=["abrupt", "fading"])


def area_and_load(trial: PartialSlip) -> tuple[np.ndarray, np.ndarray]:
    area = np.array([trial.stuck_share(frame) for frame in range(trial.n_frames)])
    return area, trial.tangential_force(trial.times) / trial.force


@TRIALS
def test_the_stuck_area_is_what_the_load_leaves(trial: PartialSlip) -> None:
    area, load = area_and_load(trial)
    friction = trial.static_friction, trial.kinetic_friction
    end = trial.full_slip - (0.2 / trial.times[-1] if trial is ABRUPT else 0)
    loading = trial.progress(trial.times) < end
    assert loading.sum() > 200
    # Rounding of the load (1e-16) is amplified by the square root near the critical load.
    np.testing.assert_allclose(area[loading], stuck_area(load[loading], *friction), rtol=0, atol=1e-12)
    assert load.max() == pytest.approx(float(critical_load_ratio(*friction)))
    assert load[-1] == pytest.approx(trial.kinetic_friction)


def test_the_critical_area_collapses_in_its_time() -> None:
    area, _ = area_and_load(ABRUPT)
    critical = float(critical_stuck_area(0.8, 0.4))
    collapsing = area[(area < critical) & (area > 0)]
    # 0.2 s at 60 frames/s, in even steps.
    assert len(collapsing) == 12
    np.testing.assert_allclose(np.diff(collapsing), -critical / 12, rtol=1e-9)
    assert (area[ABRUPT.progress(ABRUPT.times) >= 0.75] == 0).all()


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
        np.testing.assert_allclose(gone, number * 0.1625 * np.array(jumping.motion.direction), atol=1e-9)
        skin = jumping.truth.material(np.array(ellipse.centre), frame)
        np.testing.assert_allclose(skin, ABRUPT.truth.material(np.array(plain.centre), frame), atol=1e-9)


def test_jumps_before_full_slip_are_of_the_skin_that_slips() -> None:
    """Jumps before full slip are 5 px at the rim and 0 at the border of the stick region, do not change d², and are
    part of the displacement that `slow_share` limits.
    """
    jumping = PartialSlip(jumps=(2.6,))
    at = int(np.searchsorted(jumping.times, 2.6))
    motion = jumping.motion
    angle = np.linspace(0, 2 * np.pi, 7)
    for frame, gone in ((at - 1, 0.0), (at, 0.1625), (at + 20, 0.1625)):
        ellipse = jumping.truth.ellipse(frame)
        assert ellipse is not None
        stuck = float(motion.stuck_radius(torch.tensor(jumping.times[frame] / jumping.times[-1], dtype=torch.float64)))
        assert 0.5 < stuck < 0.9
        assert jumping.stuck_share(frame) == ABRUPT.stuck_share(frame) == pytest.approx(stuck**2)
        for share, expected in ((1.0, gone), (1.3, gone), ((1 + stuck) / 2, gone / 2), (stuck, 0.0), (stuck / 2, 0.0)):
            # A jump moves skin along the pull: the positions on the ellipse are those on the glass, not on the skin.
            turned = np.stack((share * 5.0 * np.cos(angle), share * 4.2 * np.sin(angle)), -1)
            turn = np.array([[math.cos(0.14), math.sin(0.14)], [-math.sin(0.14), math.cos(0.14)]])
            places = ellipse.centre + turned @ turn
            moved = ABRUPT.truth.material(places, frame) - jumping.truth.material(places, frame)
            np.testing.assert_allclose(moved, np.broadcast_to(expected * np.array(motion.direction), (7, 2)), atol=1e-9)
        radius = np.linspace(0, 1, 100_001)
        progress = torch.tensor(jumping.times[frame] / jumping.times[-1], dtype=torch.float64)
        slipped = motion._slip_at(torch.from_numpy(radius), motion.stuck_radius(progress), motion.jumped(progress))
        assert jumping.slow_share(frame) == pytest.approx(radius[int((slipped < 0.04).sum())] ** 2, abs=1e-4)


def test_jumps_that_would_tear_the_skin_are_refused() -> None:
    for early in (0.0, 0.3):
        with pytest.raises(ValueError, match=f"jumps has {early} s: .* of the contact slip then.* make it later"):
            PartialSlip(jumps=(early,))


def test_forces_drift() -> None:
    plain, drifting = (PartialSlip(force_drift=drift, n_frames=60).forces() for drift in (0.0, 0.02))
    late = plain.time > 0
    for name in ("normal_force", "tangential_force"):
        difference = getattr(drifting, name) - getattr(plain, name)
        np.testing.assert_allclose(difference[late], 0.02 * plain.time[late], atol=1e-12)
        assert (difference[~late] == 0).all()
