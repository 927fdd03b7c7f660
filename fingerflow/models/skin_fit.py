"""Friction and stiffness of the skin chain from a measured press: its divergence or contact against normal force."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student
from torch import Tensor

from fingerflow.models.skin_chain import press
from fingerflow.models.skin_parameters import SkinParameters, named

_STEP = 0.03  # of a logarithm: contact grows by elements, over which a difference must go
_FARTHEST = 50.0  # times the first guess, either way


@dataclass(frozen=True)
class SkinFit:
    """Estimates and their intervals (low, high) at `level`; None of what was taken as given."""

    friction: float
    friction_interval: tuple[float, float] | None
    tissue_stiffness: float  # N/m, k_t of one of 501 elements
    tissue_interval: tuple[float, float] | None
    level: float
    misfit: float  # root of the mean square of residuals over their errors: 1 if errors are right and the model is
    count: int  # of measured numbers
    parameters: SkinParameters  # with the stiffness that was found


def fit_skin(
    load_n: Tensor,
    divergence: Tensor | None = None,
    contact_length_m: Tensor | None = None,
    *,
    divergence_error: float = 1e-3,
    contact_error_m: float = 1e-4,
    parameters: str | SkinParameters = "lab",
    friction: float = 0.2,
    level: float = 0.95,
    elements: int = 501,
) -> SkinFit:
    """Least squares in the logarithms of what the curves determine; the plate's stiffness stays in its ratio to k_t.

    Divergence alone gives friction at the stiffness of ``parameters``, contact alone that stiffness at ``friction``,
    both give both: from divergence alone more of the one looks like less of the other. Intervals are those of the
    linear model at the best fit, with Student's quantile and the spread that residuals have: in the logarithm, so that
    they hold the estimate and no negative number. Divergence hardly depends on a friction under which everything sticks
    (above 0.2 or so): a wide interval says so.

    Args:
        load_n: (K,) N, normal forces of the measured numbers, each taken as a press of its own from nothing.
        divergence: (K,) without unit, median along the contact; NaN where it is not known.
        contact_length_m: (K,) m; of an area A of contact that is round, sqrt(4 A / pi).
        divergence_error, contact_error_m: standard deviations of the two, which weigh them against each other.
        friction: where the search begins, or what is given.

    Raises:
        ValueError: fewer than three measured numbers, shapes that do not belong together, a force that is not positive,
            or a friction or stiffness that runs to 50 times where it began or a fiftieth.
    """
    given = {"divergence": (divergence, divergence_error), "contact_length": (contact_length_m, contact_error_m)}
    measured = {name: values.double() for name, (values, _) in given.items() if values is not None}
    errors = {name: error for name, (_, error) in given.items()}
    if load_n.ndim != 1 or any(values.shape != load_n.shape for values in measured.values()):
        shapes = {name: tuple(values.shape) for name, values in measured.items()}
        raise ValueError(f"load_n {tuple(load_n.shape)}, measured {shapes}: give (K,) of each")
    if not bool((load_n > 0).all()):
        raise ValueError(f"a normal force of {load_n.min().item():g} N: leave out what is not pressed")
    known = {name: values.isfinite() for name, values in measured.items()}
    count = sum(int(where.sum()) for where in known.values())
    if count < 3:
        raise ValueError(f"{count} measured numbers for one or two unknowns: give three or more")
    skin = named(parameters)
    begin = np.log([friction, float(skin.tissue_stiffness)])
    free = np.array([divergence is not None, contact_length_m is not None])
    first = begin[free]

    def at(logarithms: Tensor) -> Tensor:
        """Residuals (S, count) of sets (S, 2), all presses together."""
        both = torch.from_numpy(begin).repeat(len(logarithms), 1)
        both[:, torch.from_numpy(free)] = logarithms
        mu, tissue = both.exp()[..., None].unbind(1)
        ratio = skin.contact_stiffness / skin.tissue_stiffness
        pressed = press(
            mu,
            replace(skin, tissue_stiffness=tissue, contact_stiffness=ratio * tissue),
            load_n.double(),
            elements=elements,
        )
        parts = [
            (getattr(pressed, name)[:, known[name]] - values[known[name]]) / errors[name]
            for name, values in measured.items()
        ]
        return torch.cat(parts, 1)

    def residuals(logarithms: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(at(torch.from_numpy(logarithms)[None])[0])

    def slopes(logarithms: NDArray[np.float64]) -> NDArray[np.float64]:
        steps = _STEP * np.eye(len(first))
        values = np.asarray(at(torch.from_numpy(np.concatenate((logarithms + steps, logarithms - steps)))))
        return np.asarray((values[: len(first)] - values[len(first) :]).T / (2 * _STEP))

    reach = np.log(_FARTHEST)
    found = least_squares(residuals, first, slopes, bounds=(first - reach, first + reach), xtol=1e-6, ftol=1e-8)
    values = begin.copy()
    values[free] = found.x
    mu, tissue = np.exp(values).tolist()
    if (np.abs(found.x - first) > 0.999 * reach).any():
        raise ValueError(
            f"friction {mu:g}, stiffness {tissue:g} N/m at the end of the search: these curves do not determine them; "
            "begin at another friction or with other parameters, or give both curves"
        )
    freedom = count - len(first)
    covariance = 2 * found.cost / freedom * np.linalg.pinv(found.jac.T @ found.jac)
    half = np.minimum(student.ppf((1 + level) / 2, freedom) * np.sqrt(np.diag(covariance)), 700.0)  # exp has no more
    ends = iter(np.exp(np.stack((found.x - half, found.x + half), 1)).tolist())
    intervals = [tuple(next(ends)) if one else None for one in free]
    return SkinFit(
        friction=mu,
        friction_interval=intervals[0],
        tissue_stiffness=tissue,
        tissue_interval=intervals[1],
        level=level,
        misfit=float(np.sqrt(2 * found.cost / count)),
        count=count,
        parameters=replace(
            skin,
            tissue_stiffness=tissue,
            contact_stiffness=skin.contact_stiffness / skin.tissue_stiffness * tissue,
        ),
    )
