"""Cramer-Rao bound of the friction ratio mu_k / mu_s, as estimated from stuck area against load ratio of a trial."""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from fingerflow.models.partial_slip import stuck_area
from fingerflow.synthetic import PartialSlip

_STEP = 1e-6  # for difference quotients in float64


class FrictionBound(NamedTuple):
    """Relative bound of mu_k / mu_s in a trial; NaN where the frames do not determine it.

    Attributes:
        deviation: least standard deviation of any unbiased estimate.
        shift: bias of the least-squares fit where d² is too large by the given offset in all frames.
    """

    deviation: float
    shift: float


def friction_bound(trial: PartialSlip, noise: float, offset: float) -> FrictionBound:
    """Compute the bound for both coefficients of equation 5 (Terekhov & Hayward 2011), from frames with a model d².

    The information of the frames is J' J / v, J the derivatives of d² by mu_s and mu_k, v the variance of d²: noise^2,
    and the noise of both forces through the slope of d² over T/N. Frames count as independent.

    Args:
        trial: coefficients, forces and their noise.
        noise: standard deviation of d², independent from frame to frame.
        offset: bias of d², the same in all frames.
    """
    progress = trial.progress(trial.times)
    loaded = torch.as_tensor(np.asarray(progress)[np.asarray(progress) < trial.motion.loaded])
    ratio = trial.motion.load_ratio(loaded).double().numpy()
    static, kinetic = trial.static_friction, trial.kinetic_friction

    def share(load: NDArray[np.float64], mu_s: float, mu_k: float) -> NDArray[np.float64]:
        return np.asarray(stuck_area(torch.from_numpy(load), mu_s, mu_k))

    ratio = ratio[ratio > _STEP]
    here = share(ratio, static, kinetic)
    by_friction = np.stack(
        (share(ratio, static + _STEP, kinetic) - here, share(ratio, static, kinetic + _STEP) - here), axis=1
    )
    slope = (here - share(ratio - _STEP, static, kinetic)) / _STEP
    variance = noise**2 + (slope * trial.force_noise / trial.force) ** 2 * (1 + ratio**2)
    known = np.isfinite(by_friction).all(axis=1) & np.isfinite(variance)
    jacobian, weight = by_friction[known] / _STEP, 1 / variance[known]
    information = jacobian.T @ (weight[:, None] * jacobian)
    if known.sum() < 2 or np.linalg.cond(information) > 1 / np.finfo(float).eps:
        return FrictionBound(np.nan, np.nan)
    covariance = np.linalg.inv(information)
    relative = np.array([-1 / static, 1 / kinetic])  # of the ratio, by both
    moved = covariance @ (jacobian.T @ (weight * offset))
    return FrictionBound(float(np.sqrt(relative @ covariance @ relative)), float(relative @ moved))
