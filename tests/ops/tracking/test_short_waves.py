"""Correction of points for short waves of the displacement: waves that windows have flattened, and noise alone.

Points are made as windows of 21 px show them: a wave of K px loses the share 1 - sin(pi n / K) / (pi n / K). Templates
do not lean, so only the flattening is corrected.
"""

import math

import pytest
import torch
from torch import Tensor

from fingerflow.kernels.tracking_limits import NUMBERS, Number
from fingerflow.ops.tracking.deformation import correct_points
from fingerflow.ops.tracking.short_waves import WIDE, correct_short_waves

WINDOW, NOISE = 21, 0.005  # px
SIDE = torch.arange(0.0, 300.0, 9.0)
START = torch.cartesian_prod(SIDE, SIDE)[None]


def shown(period: float, height: float) -> tuple[Tensor, Tensor]:
    """Return the true displacement (1, N, 2) of a wave, and positions as windows show them, with noise."""
    turn = 2 * math.pi / period
    true = height * torch.stack((torch.sin(turn * START[..., 0]), torch.cos(turn * START[..., 1])), dim=2)
    kept = math.sin(turn * WINDOW / 2) / (turn * WINDOW / 2)
    noise = NOISE * torch.randn(START.shape, generator=torch.Generator().manual_seed(5))
    return true, START + kept * true + noise


def corrected(points: Tensor, short: bool, start: Tensor = START) -> tuple[Tensor, Tensor]:
    """Return displacements (K, N, 2) and their variances after one of the two corrections."""
    numbers = torch.zeros(len(points), points.shape[1], NUMBERS)
    numbers[..., Number.COVARIANCE_XX], numbers[..., Number.NOISE] = 1.0, NOISE**2
    covariance = (NOISE**2 * torch.eye(2)).expand(*points.shape, 2)
    given = start, points, covariance, numbers, torch.eye(2).expand(*points.shape, 2)
    wide = correct_points(*given, WINDOW, WIDE * WINDOW)
    result = correct_short_waves(wide, *given, WINDOW) if short else wide
    return result.points - start, result.covariance.diagonal(dim1=2, dim2=3)


def errors(period: float, height: float, short: bool) -> tuple[float, float]:
    """Return the RMS error, px, and the RMS of the error over its stated deviation, away from the rim."""
    true, points = shown(period, height)
    found, variance = corrected(points, short)
    inner = ((START > 30) & (START < 270)).all(-1)
    error = (found - true)[inner]
    return float(error.square().mean().sqrt()), float((error.square() / variance[inner]).mean().sqrt())


@pytest.mark.parametrize(("period", "height"), [(55.0, 0.1), (55.0, 0.5), (100.0, 0.5)])
def test_short_waves_are_restored_and_their_deviation_is_true(period: float, height: float) -> None:
    """The error falls below 0.7 of that of the wide correction, and the deviation states it: measured 0.50 to 0.59 and
    0.72 to 1.02 deviations.
    """
    wide, _ = errors(period, height, short=False)
    short, z = errors(period, height, short=True)
    assert short < 0.7 * wide
    assert 0.6 < z < 1.3


@pytest.mark.parametrize("height", [0.0, 0.1])
def test_noise_and_long_waves_are_left_alone(height: float) -> None:
    """In uniform motion and waves of 400 px a narrow correction would add noise: the error grows by 2 % at most."""
    wide, _ = errors(400.0, height, short=False)
    short, z = errors(400.0, height, short=True)
    assert short < 1.02 * wide
    assert 0.9 < z < 1.15


def test_sparse_and_lost_points_keep_the_wide_correction() -> None:
    """Where the nearest neighbour is a window away, nothing shows a short wave; a lost point stays lost and takes part
    in no fit.
    """
    _, points = shown(55.0, 0.5)
    apart = ((START / 9.0).round().long() % 3 == 0).all(-1)[0]
    sparse, start = points[:, apart], START[:, apart]
    for one, of_wide in zip(corrected(sparse, True, start), corrected(sparse, False, start), strict=True):
        torch.testing.assert_close(one, of_wide)
    lost = points.clone()
    lost[0, 500] = torch.nan
    found, _ = corrected(lost, short=True)
    assert found[0, 500].isnan().all()
    assert found.isnan().sum() == 2
