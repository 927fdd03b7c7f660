"""Tests of the flag of incipient slip: it stays off while skin moves rigidly with noise, and is raised when a rim
begins to slip.
"""

import math

import numpy as np
import pytest
import torch

from fingerflow.ops.fields.rigid_motion import rigid_residual
from fingerflow.tracker.slip_flag import SlipFlag, rigid_residual_rms

DRAW = np.random.default_rng(0)
POINTS = 300 * DRAW.random((400, 2))
STD = np.full(400, 0.03)
COVERED = np.ones(400, np.uint8)


def turned(angle: float, shift: tuple[float, float]) -> np.ndarray:
    cosine, sine = math.cos(angle), math.sin(angle)
    return POINTS @ np.array([[cosine, sine], [-sine, cosine]]) + shift


def noise() -> np.ndarray:
    return 0.03 * DRAW.standard_normal(POINTS.shape)


def test_the_residual_is_that_of_the_op() -> None:
    after = turned(0.2, (3.0, -2.0)) + 0.5 * np.sin(POINTS / 40)
    expected = rigid_residual(torch.from_numpy(POINTS)[None], torch.from_numpy(after - POINTS)[None])[0]
    before, after = (one.view(np.complex128)[:, 0] for one in (POINTS, after))
    assert rigid_residual_rms(before, after) == pytest.approx(float(expected.square().mean().sqrt()), rel=1e-9)


def test_rigid_motion_raises_nothing_and_slip_does_two_frames_later() -> None:
    flag, radius = SlipFlag(), np.linalg.norm(POINTS - 150, axis=1) / 150
    for frame in range(60):
        residual = flag.update(turned(0.002 * frame, (0.1 * frame, 0.0)) + noise(), STD, COVERED)
        assert not flag.slipping
        assert frame == 0 or residual == pytest.approx(0.03 * math.sqrt(2), rel=0.15)
    raised = []
    for _ in range(4):
        # The rim slips by 0.3 px, ten times the noise.
        flag.update(POINTS + noise() + 0.3 * (radius > 0.8)[:, None] * [1.0, 0.0], STD, COVERED)
        raised.append(flag.slipping)
    assert raised == [False, False, True, True]


def test_the_flag_outlives_a_choice_of_other_points() -> None:
    """After points are seeded again, new points take over the displacement of the nearest old points, and flag and
    residual stay: on skin whose rim is 3 px ahead, to 0.3 px, the error of a mean of four neighbours some 15 px away.
    Lost points do not end the slip, and the end of the contact does.
    """
    old, new = POINTS[:200], 300 * np.random.default_rng(4).random((150, 2))
    std, covered = np.full(200, 0.03), np.ones(200, np.uint8)

    def slipped(points: np.ndarray) -> np.ndarray:
        ahead = 1 + 3 * np.square((points - 150) / 150).sum(1)
        return points + np.stack((ahead, 0 * ahead), 1)

    flag = SlipFlag()
    flag.update(old, std, covered)
    for _ in range(4):
        residual = flag.update(slipped(old), std, covered)
    assert flag.slipping
    flag.follow_others(slipped(old), slipped(new))
    after = [(flag.update(slipped(new), std[:150], covered[:150]), flag.slipping) for _ in range(6)]
    assert all(slipping for _, slipping in after)
    assert after[-1][0] == pytest.approx(residual, rel=0.15)
    lost = np.full_like(new, np.nan)
    for _ in range(6):
        flag.update(lost, std[:150], covered[:150])
        assert flag.slipping
    for _ in range(3):
        flag.update(slipped(new), std[:150], 0 * covered[:150])
    assert not flag.slipping
