"""Tests of stated standard deviations against errors of simulated tracks: z is the RMS of the error over that of the
stated deviation.

Points move with a uniform deformation while the contact grows over them. Each is tracked with noise that correlates as
windows overlap, and comes into contact at the border, to a frame and to the uncertainty of the border. The truth is the
result of the same estimators for exact positions and times, so that smoothing is no part of the error.
"""

from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from stages_alone import inputs_of, run, trial_of, values_of

from fingerflow.pipeline.stages.deformation.deformation_stage import DeformationStage
from fingerflow.pipeline.stages.preparation.inputs import Inputs
from fingerflow.pipeline.stages.stage import RunContext
from fingerflow.pipeline.stages.strain.strain_stage import StrainStage
from fingerflow.tracker.contact_border import BORDER_MM

FRAMES, MM_PER_PX, SPEED = 36, 0.03, 0.1  # SPEED is that of the border, mm per frame
WINDOW_PX = 25


class Motion(NamedTuple):
    """Motion per frame: shift in mm, gradient, and noise of a position in px."""

    shift: tuple[float, float]
    gradient: tuple[tuple[float, float], tuple[float, float]]
    noise: float


def inputs(template: str = "keyframe") -> Inputs:
    return inputs_of(FRAMES, MM_PER_PX, "green_lagrange", template)


def contact() -> dict[str, NDArray[np.float64]]:
    size = 0.5 + SPEED * np.arange(FRAMES)
    return {
        "gross_contact_area": np.pi * size**2,
        "ellipse_center": np.zeros((FRAMES, 2)),
        "ellipse_semi_axes": np.stack((size, size), axis=1),
        "ellipse_angle": np.zeros(FRAMES),
    }


def material() -> NDArray[np.float64]:
    axis = np.arange(-4.2, 4.21, 0.38)
    nodes = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    return nodes + 0.1 * np.random.default_rng(1).uniform(-1, 1, nodes.shape)


def positions(motion: Motion, points: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions (T, N, 2) mm at times (T, N) or (T, 1)."""
    velocity = np.array(motion.shift) + points @ np.array(motion.gradient).T
    return points + times[..., None] * velocity


def _shared(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the factor (N, N) that gives independent numbers the correlation of overlapping windows, as on a press."""
    apart = np.abs(points[:, None] - points) / MM_PER_PX / WINDOW_PX
    return np.linalg.cholesky(np.clip(1 - apart, 0, None).prod(-1))


def tracked(motion: Motion, points: NDArray[np.float64], seed: int, known: int = FRAMES, kept: int = 0) -> RunContext:
    """Return the run context of simulated tracks with key frame 0: the noise of its template is part of every later
    position, and the covariance of a position is that of both images.

    From frame `known` on every point but the first `kept` is lost.
    """
    draw = np.random.default_rng(seed)
    noise = motion.noise / np.sqrt(2) * (_shared(points) @ draw.standard_normal((FRAMES, *points.shape)))
    exact = positions(motion, points, np.arange(FRAMES, dtype=float)[:, None])
    pixels = exact / MM_PER_PX + noise - noise[0]
    pixels[known:, kept:] = np.nan
    deviation = np.full(pixels.shape[:2], motion.noise, np.float32)
    deviation[0] = 0
    border = 0.5 + SPEED * np.arange(FRAMES)[:, None]
    place = np.linalg.norm(exact, axis=-1) + BORDER_MM * draw.standard_normal(len(points))
    given = inputs()
    measured = {"position": given.geometry.on_glass(pixels), "position_px": pixels, "position_std_px": deviation}
    return trial_of(given, contact(), FRAMES, **measured, in_contact=place < border)


def measured(trial: RunContext, moved: DeformationStage | None = None) -> RunContext:
    """Return the run context after the stages of displacement, fields and strain."""
    run(trial, moved or DeformationStage(trial), StrainStage(trial))
    return trial


@pytest.mark.parametrize(
    ("template", "variance", "expected"),
    [
        ("keyframe", [0, 2, 2, 2], [[0, 2], [2, 0.5], [2, 1.5], [2, 1.5]]),
        ("previous", [0, 2, 4, 6], [[0, 2], [2, 0.5], [4, 2.5], [6, 4.5]]),  # variances add up
    ],
)
def test_noise_of_the_template_falls_out(template: str, variance: list[float], expected: list[list[float]]) -> None:
    """Noise of the template cancels in differences of positions with key frame 0: a position has the variance 2, half
    from the template, and a difference of two positions 1 + 1.

    The other point touches half way between the key frame and the next frame, so its reference has half of that noise.
    """
    deviation = np.sqrt(np.array([variance, variance], np.float32).T)
    position = np.zeros((4, 2, 2))
    covered = np.array([[1, 0], [1, 1], [1, 1], [1, 1]], bool)
    given = {"position": position, "position_px": position, "position_std_px": deviation, "in_contact": covered}
    trial = trial_of(inputs(template), contact(), 4, **given)
    run(trial, DeformationStage(trial))
    found = values_of(trial, "displacement_std") ** 2 / MM_PER_PX**2
    np.testing.assert_allclose(found[:, 0], np.array(expected)[:, 0], rtol=1e-5)
    np.testing.assert_allclose(found[1:, 1], np.array(expected)[1:, 1], rtol=1e-5, atol=1e-6)


def test_a_point_that_was_lost_at_its_onset_has_none() -> None:
    """A point lost at its onset has no onset; otherwise a later frame would be taken for the onset."""
    position = np.zeros((4, 3, 2)) + np.arange(4)[:, None, None]
    position[1, 1] = np.nan
    covered = np.array([[0, 0, 0], [1, 1, 0], [1, 1, 0], [1, 1, 0]], dtype=bool)
    rest = np.zeros((4, 3), np.float32)
    given = {"position": position, "position_px": position, "position_std_px": rest, "in_contact": covered}
    trial = trial_of(inputs(), contact(), 4, **given)
    run(trial, DeformationStage(trial))
    moved = values_of(trial, "displacement")
    assert values_of(trial, "onset_frame").tolist() == [1, -1, -1]
    assert np.isnan(moved[:, 1:]).all()
    assert np.isfinite(moved[1:, 0]).all()


@pytest.mark.parametrize("window_s", [0.05, 0.01])
def test_the_strain_rate_of_triangles_has_its_deviation(window_s: float) -> None:
    """F = I + t G has the rate of strain sym(G) + t G' G, also in triangles known in five frames or fewer."""
    motion = Motion((0.002, 0.001), ((0.001, 0.0002), (0.0, 0.0008)), 0.05)
    trial = tracked(motion, material(), 0)
    trial.requested, trial.inputs.scene.fields.reference = frozenset(("strain_rate", "strain_rate_std")), "first_frame"
    trial.inputs.scene.fields.rate_window_s = window_s
    found = measured(trial)
    gradient, frame = np.array(motion.gradient), np.arange(FRAMES)[:, None, None]
    truth = 300 * ((gradient + gradient.T) / 2 + frame * gradient.T @ gradient)[:, None, [0, 1, 0], [0, 1, 1]]
    z = (values_of(found, "strain_rate") - truth) / values_of(found, "strain_rate_std")
    assert np.isfinite(z).mean() > 0.2  # triangles that touch long enough
    np.testing.assert_allclose(np.sqrt(np.nanmean(z**2, axis=(0, 1))), 1, atol=0.2)
