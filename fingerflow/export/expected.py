"""Expected results of the built-in test frame of a bundle, computed by torch in float64."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from fingerflow.engines.check import THRESHOLD, built_in
from fingerflow.export.build import build
from fingerflow.export.recipe import Recipe
from fingerflow.kernels.tracking_limits import ROUNDS
from fingerflow.ops.tracking.templates import Found, Templates, in_rounds

_DIGITS = 6


def expected_numbers(recipe: Recipe) -> dict[str, Any]:
    """Compute, by torch in float64, the contact and the tracked points in the built-in test frame that an engine must
    reproduce; return them with the sizes of the frame, for `engines.check.check_engine`.
    """
    views, own = recipe.views, recipe.tracking
    size = {"height": views.height, "width": views.width, "bit_depth": views.bit_depth, "points": own.points}
    frame = built_in(**size, window_px=own.window_px)
    graphs = build(recipe, torch.float64)
    known: dict[str, Tensor] = {
        "empty": _picture(frame.empty).double(),
        "dark": torch.zeros(1, 1, views.height, views.width, dtype=torch.float64),
        "contact_view": _picture(frame.contact),
        "threshold": torch.tensor([THRESHOLD], dtype=torch.float64),
        "topography_view": _picture(frame.key),
        "points": torch.from_numpy(frame.points).double()[None],
        "prediction": torch.from_numpy(frame.expected).double()[None],
        "inverse_warp": torch.eye(2, dtype=torch.float32).expand(1, own.points, 2, 2),
    }

    known |= graphs["light"].run(known)
    contact = graphs["contact"].run(known)
    known |= graphs["noise"].run(known)
    known |= graphs["prepare"].run(known)
    known["topography_view"] = _picture(frame.topography)
    templates = Templates(*(known[f"template_{name}"] for name in Templates._fields))

    def step(some: Templates, near: Tensor) -> Found:
        of_templates = {f"template_{name}": one for name, one in some._asdict().items()}
        return Found(**graphs["track"].run({**known, **of_templates, "prediction": near}))

    found = in_rounds(step, templates, known["prediction"], ROUNDS)
    known |= {"start": templates.start, "found": found.points, "found_covariance": found.covariance}
    known |= graphs["support"].run(known)
    corrected = graphs["correct"].run(known)
    variance = corrected["covariance"].diagonal(dim1=-2, dim2=-1).mean(-1)
    numbers = {
        **{name: contact[name] for name in ("real_area_px", "gross_area_px", "center", "semi_axes")},
        "found": found.points,
        "corrected": corrected["points"],
        "deviation": variance.sqrt(),
    }
    return {**size, "numbers": {name: rounded(value[0].numpy()) for name, value in numbers.items()}}


def _picture(view: np.ndarray[Any, Any]) -> Tensor:
    return torch.from_numpy(view)[None, None]


def rounded(values: np.ndarray[Any, Any]) -> Any:
    """Convert an array to nested lists of rounded numbers, with None for NaN, which JSON cannot represent."""
    if values.ndim:
        return [rounded(one) for one in values]
    return round(float(values), _DIGITS) if np.isfinite(values) else None
