"""Tests of the parts of a uniform field: divergence, curl, shears, principal strains, and the residual of the best
rigid motion.
"""

import numpy as np
from stages_alone import inputs_of, run, trial_of, values_of

from fingerflow.pipeline.stages.deformation.deformation_stage import DeformationStage
from fingerflow.pipeline.stages.strain.strain_stage import StrainStage
from fingerflow.tracker.deviations.rigid_residual import residual_deviations

GRADIENT = np.array([[0.02, 0.013], [-0.005, -0.01]])
FRAMES, SCALE = 16, 0.03


def test_parts_of_a_uniform_gradient() -> None:
    axis = np.arange(0.0, 4.0, 0.4)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    position = points + np.linspace(0, 3, FRAMES)[:, None, None] * (points @ GRADIENT.T + [0.1, -0.2])
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
    names = ("divergence", "curl", "shear", "strain_rate", "principal_strains", "principal_angle", "rigid_residual")
    trial.requested = frozenset((*names, "strain_rate_std"))
    run(trial, DeformationStage(trial), StrainStage(trial))
    found = {name: values_of(trial, name)[-1] for name in names}
    ux, uy, vx, vy = 3 * GRADIENT.ravel()
    symmetric = 1.5 * (GRADIENT + GRADIENT.T)
    strains, vectors = np.linalg.eigh(symmetric)
    parts = {"divergence": ux + vy, "curl": vx - uy, "shear": [ux - vy, uy + vx], "principal_strains": strains[::-1]}
    parts["strain_rate"] = symmetric[[0, 1, 0], [0, 1, 1]] / trial.inputs.times[-1]
    for name, expected in parts.items():
        known = np.isfinite(found[name]).reshape(len(found[name]), -1).all(1)
        assert known.mean() > 0.9  # too few points lie within the gauge length at corners
        values = found[name][known]
        np.testing.assert_allclose(values, np.broadcast_to(expected, values.shape), atol=1e-5)
    turned = found["principal_angle"] - np.arctan2(vectors[1, 1], vectors[0, 1])
    np.testing.assert_allclose(np.sin(turned), 0, atol=1e-3)
    # The symmetric part of the gradient remains, to second order in the rotation.
    np.testing.assert_allclose(found["rigid_residual"], (points - 1.8) @ symmetric.T, atol=3e-3)


def test_noise_alone_is_within_the_deviation_of_its_median_length() -> None:
    """2000 points at rest have residuals of noise alone: the deviation of their median length equals it, to 5 %. Where
    skin has moved far, noise hardly changes lengths, and the deviation is that by curvature.
    """
    noise = np.full((1, 2000), 0.001**2)
    length = np.hypot(*np.random.default_rng(5).normal(0, 0.001, (2, *noise.shape)))
    median = np.median(length, 1)
    of_points, of_median = residual_deviations(length, median, noise, noise, 0 * noise)
    np.testing.assert_allclose(of_median, median, rtol=0.05)
    np.testing.assert_allclose(of_points, 0.001 * np.hypot(1, 0.5))
    _, of_median = residual_deviations(length + 9, median + 9, 5 * noise, noise, 4 * noise)
    np.testing.assert_allclose(of_median, 1.4 * 0.002, rtol=1e-3)
    assert np.isnan(
        np.concatenate(residual_deviations(length + np.nan, median + np.nan, noise, noise, noise), None)
    ).all()
