"""Fit of the skin chain's friction and stiffness to measured divergence or contact length against normal force."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student
from torch import Tensor

from fingerflow.models.skin_chain import press
from fingerflow.models.skin_parameters import Number, SkinParameters, parameter_set

_STEP = 0.03  # finite-difference step of the logarithms of the parameters; contact grows by several elements in it
_FARTHEST = 50.0  # largest factor between a fitted parameter and its first guess, in both directions


@dataclass(frozen=True)
class SkinFit:
    """Fitted friction and stiffness with intervals (low, high) at `level`; None for a parameter not fitted."""

    friction: float
    friction_interval: tuple[float, float] | None
    tissue_stiffness: float  # N/m, k_t of one element of a chain with 501 elements
    tissue_interval: tuple[float, float] | None
    level: float
    misfit: float  # root mean square of residuals divided by their errors: 1 if errors and model are right
    count: int  # number of measured values
    parameters: SkinParameters  # parameters of the chain with the fitted stiffness


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
    """Fit friction and tissue stiffness k_t of a skin chain to measurements, by least squares in their logarithms.

    The ratio of plate stiffness to k_t is constant. Divergence alone determines friction at the stiffness of
    ``parameters``. Contact length alone determines that stiffness at ``friction``; both curves determine both.
    Divergence alone cannot separate the two: more friction looks like less stiffness. Intervals are those of the
    linearised model at the best fit, with Student's quantile and the spread of the residuals. They are computed in the
    logarithm, so they contain the estimate and stay positive. Above about 0.2 everything sticks and divergence hardly
    depends on friction: the interval is then wide.

    Args:
        load_n: (K,) N, normal forces of the measured values, each simulated as a separate press of an undeformed chain.
        divergence: (K,), dimensionless, median along the contact; NaN where it is not known.
        contact_length_m: (K,) m; for a round contact of area A, sqrt(4 A / pi).
        divergence_error, contact_error_m: standard deviations of the two, which weigh them against each other.
        friction: initial value, or the fixed value if it is not fitted.

    Raises:
        ValueError: fewer than three measured values, shapes that do not match, a force that is not positive,
            or a friction or stiffness that reaches 50 times or 1/50 of its initial value.
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
    skin = parameter_set(parameters)
    begin = np.log([friction, float(skin.tissue_stiffness)])
    free = np.array([divergence is not None, contact_length_m is not None])
    first = begin[free]

    def with_stiffness(tissue: Number) -> SkinParameters:
        ratio = skin.contact_stiffness / skin.tissue_stiffness
        return replace(skin, tissue_stiffness=tissue, contact_stiffness=ratio * tissue)

    def at(logarithms: Tensor) -> Tensor:
        """Return the residuals (S, count) of the measurements, relative to their errors, at S sets of the fitted
        parameters, given as logarithms; all presses run in one batch.
        """
        both = torch.from_numpy(begin).repeat(len(logarithms), 1)
        both[:, torch.from_numpy(free)] = logarithms
        mu, tissue = both.exp()[..., None].unbind(1)
        pressed = press(mu, with_stiffness(tissue), load_n.double(), elements=elements)
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
    # Clipped, since exp overflows beyond.
    half = np.minimum(student.ppf((1 + level) / 2, freedom) * np.sqrt(np.diag(covariance)), 700.0)
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
        parameters=with_stiffness(tissue),
    )
