"""Tests of the parts of a uniform field: divergence, curl, shears, principal strains, and the residual of the best
rigid motion.
"""

import numpy as np
import pytest
from stages_alone import inputs_of, run, trial_of, values_of

from fingerflow.pipeline.stages.displacement.displacement_stage import DisplacementStage
from fingerflow.pipeline.stages.fields.fields_stage import FieldsStage
from fingerflow.pipeline.stages.strain.strain_stage import StrainStage

GRADIENT = np.array([[0.02, 0.013], [-0.005, -0.01]])
FRAMES, SCALE = 4, 0.03


def measured(gradient: np.ndarray) -> dict[str, np.ndarray]:
    """Return the fields of the last frame for a displacement gradient per frame."""
    axis = np.arange(0.0, 4.0, 0.4)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    position = points + np.arange(FRAMES)[:, None, None] * (points @ gradient.T + [0.1, -0.2])
    names = ("divergence", "curl", "shear", "strain", "principal_strains", "principal_angle")
    names += ("rigid_residual", "rigid_residual_median")
    given = {
        "position": position,
        "position_px": position / SCALE,
        "position_std_px": np.full(position.shape[:2], 1e-3, np.float32),
        "in_contact": np.ones(position.shape[:2], bool),
    }
    contact = {
        "gross_contact_area": np.full(FRAMES, 10.0),
        "ellipse_center": np.full((FRAMES, 2), 1.8),
        "ellipse_semi_axes": np.full((FRAMES, 2), 1.5),
        "ellipse_angle": np.zeros(FRAMES),
    }
    trial = trial_of(inputs_of(FRAMES, SCALE, "infinitesimal"), contact, FRAMES, **given)
    trial.asked = frozenset(names)
    run(trial, DisplacementStage(trial), FieldsStage(trial), StrainStage(trial))
    return {name: values_of(trial, name)[-1] for name in names}


@pytest.fixture(scope="module")
def found() -> dict[str, np.ndarray]:
    return measured(GRADIENT)


def test_parts_add_up_to_the_gradient(found: dict[str, np.ndarray]) -> None:
    ux, uy, vx, vy = 3 * GRADIENT.ravel()
    for name, expected in (("divergence", ux + vy), ("curl", vx - uy), ("shear", [ux - vy, uy + vx])):
        known = np.isfinite(found[name]).reshape(100, -1).all(1)
        assert known.mean() > 0.9  # too few points lie within the gauge length at corners
        values = found[name][known]
        np.testing.assert_allclose(values, np.broadcast_to(expected, values.shape), atol=1e-5)


def test_a_rigid_motion_leaves_nothing_and_a_stretch_does(found: dict[str, np.ndarray]) -> None:
    turn = 0.01 * np.array([[0.0, -1.0], [1.0, 0.0]])
    assert np.abs(measured(turn)["rigid_residual"]).max() < 2e-3  # 0.03 rad: second order in the angle
    symmetric = 1.5 * (GRADIENT + GRADIENT.T)
    # The symmetric part of the gradient remains, to second order in the rotation.
    axis = np.arange(0.0, 4.0, 0.4) - 1.8
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(found["rigid_residual"], points @ symmetric.T, atol=3e-3)
    lengths = np.linalg.norm(found["rigid_residual"], axis=-1)
    np.testing.assert_allclose(found["rigid_residual_median"], np.median(lengths), rtol=1e-5)
