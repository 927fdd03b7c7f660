"""Comparison of a measured press with the skin-chain model (a row of elastic elements) under the same normal force."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.models.skin_chain import follow
from fingerflow.models.skin_fit import SkinFit, fit_skin
from fingerflow.models.skin_onset import since_onset
from fingerflow.models.skin_parameters import PARAMETERS, SkinParameters
from fingerflow.plot.axes_style import INK, TWO_COLUMNS_MM, figure_style, finished, line_styles
from fingerflow.plot.captions import describe
from fingerflow.plot.panels import row_of_panels
from fingerflow.schema.variables import VARIABLES

Values = NDArray[np.float64]
_MEDIAN = VARIABLES["median_divergence"]
INNER = 0.6  # share of the contact's radius; the divergence within depends little on the detected edge
NEEDED = ("normal_force", "gross_contact_area", "ellipse_semi_axes", "median_divergence")
_LEAST_MM2 = 3.0  # mm², least contact area: below, the ridge spacing makes the edge of the contact uncertain
_FITTED = 10  # number of forces to which the stiffness is fitted
_ELEMENTS = 1001  # twice the paper's: with 501 the fitted stiffness is 2 % larger for the same area, with 251 5 %


@dataclass(frozen=True)
class ChainComparison:
    """Contact area and divergence (median over the contact, mean over its inner part) at T normal forces: measured
    (T,), and simulated with the skin-chain model at K friction coefficients (K, T).

    Areas are in mm², divergences in the shown unit, um/mm; NaN without contact.
    """

    force: Values  # (T,) N
    area: Values
    median: Values
    inner: Values
    friction: tuple[float, ...]
    chain_area: Values
    chain_median: Values
    chain_inner: Values
    fit: SkinFit
    parameters: str

    def notes(self) -> list[str]:
        """Return sentences for the report on the assumptions of the comparison and on the tissue stiffness fitted to
        the measured area.
        """
        assert self.fit.tissue_interval is not None
        low, high = self.fit.tissue_interval
        given = PARAMETERS[self.parameters]
        return [
            f"The chain has the {self.parameters} parameters (radius {1e3 * float(given.radius):g} mm, membrane "
            f"{float(given.membrane_stiffness):.4g} N/m), turned about the axis of the contact, and is loaded with the "
            "measured normal force from nothing on; tangential force is left out.",
            f"Its tissue was fitted to the measured area at {self.fit.count} forces: k_t = "
            f"{self.fit.tissue_stiffness:.4g} N/m an element ({100 * self.fit.level:g} % interval {low:.4g} to "
            f"{high:.4g}; {float(given.tissue_stiffness):.4g} in the set), the plate's stiffness in proportion, "
            f"each force a press at rest, at a friction of {self.fit.friction:g}: the area hardly depends on it.",
            "Divergence counts from each point's first contact on both sides. That of the chain is no fit; friction is "
            "not fitted either: above 0.2 or so nearly all skin sticks, and more of it changes little.",
        ]


def compare_with_chain(result: xr.Dataset, friction: Sequence[float], parameters: str = "paper") -> ChainComparison:
    """Compare a result with the skin-chain model under the measured normal force, once for each coefficient in
    `friction`; its tissue stiffness is fitted to the measured area, all else is the parameter set `parameters`.

    Raises:
        FingerflowError: no friction or one below 0, unknown parameters, results without a compared variable, or a
        force that does not press.
    """
    if not friction or not all(0 <= one < np.inf for one in friction):
        raise FingerflowError(f"--friction {', '.join(map(str, friction))}: give one or more coefficients, 0 or more")
    if parameters not in PARAMETERS:
        raise FingerflowError(f"--chain {parameters}: choose one of {', '.join(PARAMETERS)}")
    if lacking := [name for name in NEEDED if name not in result]:
        raise FingerflowError(
            f"the result has no {', '.join(lacking)}, which a chain is compared with; process the scene for all "
            "outputs, with a force file"
        )
    force, time = result["normal_force"].values.astype(float), result["time"].values.astype(float)
    known = np.isfinite(force) & np.isfinite(time)
    area = np.nan_to_num(result["gross_contact_area"].values.astype(float))
    large = known & (area > _LEAST_MM2)
    if large.sum() < _FITTED or not force[large].max() > 0:
        raise FingerflowError(
            f"{int(large.sum())} frames have a normal force and more than {_LEAST_MM2:g} mm² of contact: {_FITTED} or "
            "more are needed beside a chain; check the force file and its trigger, or leave out --friction"
        )
    fit = _fitted(force, area, large, max(friction), PARAMETERS[parameters])
    trace = torch.from_numpy(np.clip(force[known], 0, None))
    load = trace[:, None].expand(-1, len(friction))
    pressed = follow(torch.tensor(friction, dtype=torch.float64), torch.from_numpy(time[known]), load,
                     parameters=fit.parameters, elements=_ELEMENTS)  # fmt: skip
    seen = since_onset(pressed)
    shown = np.where(large, 1.0, np.nan)[known]
    inner = inner_divergence(result)

    def of(values: torch.Tensor, factor: float) -> Values:
        return np.asarray(factor * values.T.numpy() * shown)

    return ChainComparison(
        force=force[known],
        area=area[known] * shown,
        median=_MEDIAN.shown_values(result["median_divergence"].values[known]) * shown,
        inner=inner[known] * shown,
        friction=tuple(friction),
        chain_area=of(seen.contact_area, 1e6),
        chain_median=of(seen.area_median, _MEDIAN.shown_unit.factor),
        chain_inner=of(seen.mean_within(INNER), _MEDIAN.shown_unit.factor),
        fit=fit,
        parameters=parameters,
    )


def inner_divergence(result: xr.Dataset) -> Values:
    """Return for each of F frames the mean divergence, um/mm, of the tracked points within 0.6 of the contact ellipse's
    radius from its centre; NaN without such points.
    """
    found = np.full(result.sizes["frame"], np.nan)
    if "divergence" not in result or "position" not in result:
        return found
    for frame in range(len(found)):
        (first, second), angle = result["ellipse_semi_axes"].values[frame], result["ellipse_angle"].values[frame]
        right, down = (result["position"].values[frame] - result["ellipse_center"].values[frame]).T
        along, across = np.cos(angle) * right + np.sin(angle) * down, np.cos(angle) * down - np.sin(angle) * right
        values = result["divergence"].values[frame][np.hypot(along / first, across / second) < INNER]
        values = values[np.isfinite(values)]
        found[frame] = _MEDIAN.shown_values(values.mean()) if len(values) else np.nan
    return found


def draw(beside: ChainComparison, width_mm: float = TWO_COLUMNS_MM) -> Figure:
    """Draw three panels against normal force, each as measured and as simulated by the skin-chain model: contact area,
    median divergence over the contact, and mean divergence over its inner part.
    """
    panels = (
        (VARIABLES["gross_contact_area"].axis_label, beside.area, beside.chain_area),
        (_MEDIAN.axis_label, beside.median, beside.chain_median),
        (_MEDIAN.with_unit(f"mean divergence within {INNER:g} of its radius"), beside.inner, beside.chain_inner),
    )
    styles = line_styles(len(beside.friction) + 1)[1:]
    with figure_style(width_mm):
        figure, parts = row_of_panels(3, width_mm)
        for part, (name, measured, chains) in zip(parts, panels, strict=True):
            axes = part.subplots()
            for friction, chain, style in zip(beside.friction, chains, styles, strict=True):
                axes.plot(beside.force, chain, label=f"chain, friction {friction:g}", **style)
            axes.plot(beside.force, measured, color=INK, label="measured")
            axes.set(xlabel="normal force (N)", ylabel=name)
            finished(axes)
    describe(
        figure,
        "Contact area (A), median divergence over the contact (B) and mean divergence of points within "
        f"{INNER:g} of its radius (C) against the normal force: measured, and of the skin chain pressed with the same "
        f"force. n = {int(np.isfinite(beside.area).sum())} frames.",
    )
    return figure


def _fitted(force: Values, area: Values, large: NDArray[np.bool_], friction: float, given: SkinParameters) -> SkinFit:
    """Fit the tissue stiffness of the skin-chain model to contact areas (mm²) at normal forces (N) of the frames in the
    mask `large`, up to the largest force; `given` holds its other parameters.
    """
    top = int(np.flatnonzero(large)[np.argmax(force[large])])
    rising = large & (np.arange(len(force)) <= top) & (force > 0.02 * force[top])
    at = np.unique(np.searchsorted(np.maximum.accumulate(np.where(rising, force, 0.0)),
                                   np.linspace(force[rising].min(), force[top], _FITTED)))  # fmt: skip
    at = at[rising[np.minimum(at, len(force) - 1)]]
    length = 2e-3 * np.sqrt(area[at] / np.pi)
    try:
        return fit_skin(
            torch.from_numpy(force[at]),
            contact_length_m=torch.from_numpy(length),
            parameters=replace(given),
            friction=friction,
            elements=_ELEMENTS,
        )
    except ValueError as error:
        raise FingerflowError(f"the chain's stiffness cannot be fitted to the contact area: {error}") from error
