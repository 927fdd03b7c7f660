"""Errors of tracked points against the truth."""

import math

import torch
from torch import Tensor

from bench.rows import Cell


def error_cells(errors: Tensor, accepted: Tensor, bound: Tensor | None = None) -> dict[str, Cell]:
    """Return error columns of a row.

    Args:
        errors: (N, 2) px.
        accepted: (N,) bool, the points that enter the statistics.
        bound: (N, 2, 2) px^2, the Cramer-Rao bound; None where it does not apply.

    Returns:
        ``rms_px`` over both coordinates of the accepted points, ``over_bound`` its ratio to the bound's,
        ``bias_px`` the mean error of the coordinate where it is larger, ``bias_se_px`` its standard error as if
        points were independent (their windows overlap a little), ``accepted`` the share.
    """
    share = accepted.double().mean().item()
    good = errors[accepted].double()
    if len(good) < 2:
        return {"rms_px": None, "over_bound": None, "bias_px": None, "bias_se_px": None, "accepted": share}
    rms = good.square().mean().sqrt().item()
    mean = good.mean(0)
    larger = int(mean.abs().argmax())
    over_bound = None
    if bound is not None:
        over_bound = rms / bound[accepted].diagonal(dim1=1, dim2=2).mean().sqrt().item()
    return {
        "rms_px": rms,
        "over_bound": over_bound,
        "bias_px": mean[larger].item(),
        "bias_se_px": (good[:, larger].std() / math.sqrt(len(good))).item(),
        "accepted": share,
    }


def root_mean_square(values: list[float]) -> float:
    """Compute the RMS of values that stand for equally many points."""
    return torch.tensor(values, dtype=torch.float64).square().mean().sqrt().item()
