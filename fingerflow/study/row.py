"""Summarise the result of one trial as a row of numbers, and as curves against force on a common grid."""

import json
import math
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr

from fingerflow.kernels.array_types import Numbers, Series
from fingerflow.kernels.arrays import nanmedian
from fingerflow.models.growth_laws import power_law, relaxation
from fingerflow.pipeline.stages.preparation.series import rate
from fingerflow.schema.trial_columns import AT_MAX, AT_MOMENTS, AT_ONSET, FORCES_N, NUMBERS, UNLOADING

Curve = list[float | None]

#: Forces (N), and shares of the load of a trial, at which curves are averaged over trials.
FORCE_GRID: Series = np.linspace(0.25, 20.0, 80)
SHARE_GRID: Series = np.linspace(0.02, 1.0, 50)
#: Metrics whose curve against force is kept; those against a share of the load are `BY_SHARE`.
CURVES = ("real_contact_area", "gross_contact_area", "divergence", "curl", "strain", "strain_energy")

#: Series of the table that are not variables of a result.
_COMPUTED = ("strain", "strain_across", "strain_rate", "force_angle", "coverage")
#: Series of the table that are variables of a result; `READ` lists all variables that `measure` reads.
_SERIES = {
    f"{name}{suffix}": f"{variable}{suffix}"
    for name, variable in AT_MOMENTS.items()
    if name not in _COMPUTED
    for suffix in ("", "_std")
    if f"{name}{suffix}" in NUMBERS
}
READ = (
    *_SERIES.values(), "frame_status", "normal_force", "tangential_force", "load_ratio", "actuator_position", "status",
    "in_contact", "displacement", "stuck_ratio", "ellipse_angle", "ellipse_semi_axes",
    "median_strain", "median_strain_std", "median_strain_rate", "median_strain_rate_std",
)  # fmt: skip
_JUDGED = "stuck_ratio"  # variable that has the verdict on slip among its attributes
#: Variables whose attributes `measure` reads.
DESCRIBED = (_JUDGED,)

_LARGEST_QUANTILE = 0.99
_ANGLE_SHARE = 0.1  # share of the largest force below which noise dominates T/N
_LEAST_AREA_MM2 = 3.0  # smaller contacts hold few ridges
_HELD = 0.95  # share of the largest force above which it counts as held
_LOADED = 0.05  # share of T/N at full slip from which on the finger is loaded
_SLID = 0.02  # stuck share up to which no skin counts as sticking
_FEWEST_SLID = 5  # least number of frames
_STUCK = 0.9  # d² down to which skin counts as moving with the bone's shear alone


def measure(result: xr.Dataset) -> tuple[dict[str, Any], dict[str, Curve]]:
    """Return the table row of a trial (values by the column names in `NUMBERS` and `FACTS`), computed from its
    processed result, and its curves: variables interpolated at the normal forces of `FORCE_GRID`, or at the shares of
    `SHARE_GRID`.

    None means unknown: not measured, its moment did not occur, or a frame there is not usable. The value at a force F
    is interpolated linearly between the two frames around its first crossing, after the onset and before the maximum.
    The strain along t, the major axis of the apparent contact at its maximum, is t' E t of the median components; its
    standard deviation treats their errors as independent.
    """
    trial = _Trial(result)
    row = dict.fromkeys(NUMBERS) | trial.facts()
    if not trial.touches:
        return row, {}
    numbers = trial.numbers()
    for name in AT_MOMENTS:
        for std in ("", "_std"):
            if f"{name}{std}" in NUMBERS and f"{name}{std}" in trial.series:
                for moment, value in trial.at_moments(trial.series[f"{name}{std}"]).items():
                    suffix = f"_{moment}" if f"{name}_{moment}" in NUMBERS else ""
                    numbers[f"{name}{suffix}{std}"] = value
                if f"{name}_{AT_MAX}" in NUMBERS:
                    numbers[f"{name}{std}"] = trial.at_largest(trial.series[name], trial.series[f"{name}{std}"])
    curves = {name: trial.curve(trial.series[name]) for name in CURVES if name in trial.series} | trial.share_curves()
    row |= {name: _finite(value) for name, value in numbers.items()}
    return row, {name: [*map(_finite, curve)] for name, curve in curves.items() if np.isfinite(curve).any()}


class _Trial:
    """Time series of one trial's result, sampled at contact onset, at the largest force, and at normal forces.

    Attributes:
        touches: whether the finger touches in any frame; without contact nothing but `facts` is defined.
        series: time series (F,) by the names of their columns.
    """

    def __init__(self, result: xr.Dataset) -> None:
        self._result = result
        self._time = np.asarray(result["time"].values, dtype=np.float64)
        self._window = float(json.loads(result.attrs["settings"])["fields"]["rate_window_s"])
        status = result["frame_status"].values if "frame_status" in result else np.zeros(len(self._time))
        self._usable = status == 0
        self._force = self._values("normal_force")
        self._gross = self._values("gross_contact_area")
        touching = np.flatnonzero(self._gross > 0)
        self.touches = touching.size > 0
        if not self.touches:
            return
        self._onset, self._last = int(touching[0]), int(touching[-1])
        # Frame of the largest normal force during contact; without forces, of the largest contact area.
        contact = slice(self._onset, self._last + 1)
        by = self._force if np.isfinite(self._force[contact]).any() else self._gross
        self._top = self._onset + int(np.nanargmax(by[contact]))
        # Area of a contact, and share of the largest force; frames while that rises and, in reverse, while it falls.
        self._area = np.where(self._gross > 0, self._gross, np.nan)
        largest = self._force[self._top]
        self._share = self._force / (largest if largest > 0 else np.nan)
        self._rising = np.arange(max(self._onset - 1, 0), self._top + 1)
        self._falling = np.arange(self._last, self._top - 1, -1)
        self.series = self._series()

    def _values(self, name: str) -> Series:
        """Return a variable of the trial's result with NaN in unusable frames; NaN in all if the result lacks it."""
        values = np.array(self._result.get(name, np.full(len(self._time), np.nan)), dtype=np.float64)
        values[~self._usable] = np.nan
        return values

    def _series(self) -> dict[str, Series]:
        series = {name: self._values(variable) for name, variable in _SERIES.items() if variable in self._result}
        series |= self._strains()
        pressed = self._force >= _ANGLE_SHARE * np.nanmax(self._force, initial=0.0)
        series["force_angle"] = np.where(pressed, np.abs(np.arctan(self._values("load_ratio"))), np.nan)
        if "status" in self._result and "in_contact" in self._result:
            covered = self._result["in_contact"].values > 0
            tracked = covered & (self._result["status"].values == 0)
            count = covered.sum(1)
            series["coverage"] = np.where((count > 0) & self._usable, tracked.sum(1) / np.maximum(count, 1), np.nan)
        return series

    def _strains(self) -> dict[str, Series]:
        if "median_strain" not in self._result:
            return {}
        angle = float(self._result["ellipse_angle"].values[self._top])
        strains = {}
        for name, turned in (("strain", angle), ("strain_across", angle + np.pi / 2), ("strain_rate", angle)):
            cosine, sine = np.cos(turned), np.sin(turned)
            weights = np.array([cosine**2, sine**2, 2 * cosine * sine])
            strains[name] = self._values(AT_MOMENTS[name]) @ weights
            strains[f"{name}_std"] = np.sqrt(self._values(f"{AT_MOMENTS[name]}_std") ** 2 @ weights**2)
        return strains

    def at_moments(self, series: Series) -> dict[str, float]:
        """Return the values of a time series at the moments of the trial."""
        at_forces = self.curve(series, np.array(FORCES_N))
        moments = {AT_ONSET: float(series[self._onset]), AT_MAX: float(series[self._top])}
        return moments | {f"at_{force:g}n": float(value) for force, value in zip(FORCES_N, at_forces, strict=True)}

    def curve(self, series: Series, forces: Series = FORCE_GRID) -> Series:
        """Return a time series of the trial where the normal force first reaches each of `forces` (N)."""
        return _at(forces, self._force, series, self._rising)

    def share_curves(self) -> dict[str, Series]:
        """Return the curves of `BY_SHARE`: area and pressure while the normal force rises and falls, and d² until the
        last skin slips.
        """
        curves: dict[str, Series] = {}
        relative = self._area / self._area[self._top]
        for name, values in {"relative_area": relative, "mean_pressure": 1e3 * self._force / self._area}.items():
            for suffix, frames in (("", self._rising), (UNLOADING, self._falling)):
                curves[f"{name}{suffix}"] = _at(SHARE_GRID, self._share, values, frames)
        if (slip := self._slip_loading) is not None:
            stuck, ratio, load, frames = slip
            curves["stuck_ratio"] = _at(SHARE_GRID, ratio / load, stuck, frames)
        return curves

    def at_largest(self, series: Series, values: Series) -> float:
        """Return the element of `values` (F,) in the frame in which `series` (F,) is largest between onset and end of
        contact; NaN if it is not known there.
        """
        contact = series[self._onset : self._last + 1]
        return float(values[self._onset + np.nanargmax(contact)]) if np.isfinite(contact).any() else np.nan

    def numbers(self) -> dict[str, float]:
        """Return numbers that describe the trial as a whole, such as its duration and its largest force."""
        since_onset = self._time - self._time[self._onset]
        force_rate = rate(self._force, self._time, self._window)
        numbers = {
            "duration": since_onset[self._last],
            "max_force": self._force[self._top],
            "time_to_max_force": since_onset[self._top] if np.isfinite(self._force[self._top]) else np.nan,
            "force_rate": _largest(force_rate[self._onset : self._top + 1]),
        }
        if "ellipse_semi_axes" in self._result:
            numbers["longest_axis_ratio"] = np.divide(*self._values("ellipse_semi_axes")[self._top])
        if "displacement" in self._result:
            numbers |= self._displacement_numbers()
        ratio = self._values("load_ratio")
        slid = np.isfinite(ratio) & (self._values(_JUDGED) <= _SLID)
        if slid.sum() >= _FEWEST_SLID:
            numbers["friction"] = float(np.median(np.abs(ratio[slid])))
            numbers["friction_force"] = float(np.nanmedian(self._force[slid]))
        return numbers | self._full_slip() | self._contact_numbers()

    def _contact_numbers(self) -> dict[str, float]:
        """Return how the contact grows with force, in time at the largest force, and how it shrinks again."""
        largest = self._force[self._top]
        rising = np.arange(self._onset, self._top + 1)
        rising = rising[(self._force[rising] >= _ANGLE_SHARE * largest) & (self._gross[rising] > _LEAST_AREA_MM2)]
        tenth = np.arange(rising.size) * 10 // max(rising.size, 1)
        growth = power_law(self._force[rising], self._gross[rising], tenth)
        left = np.flatnonzero(~(self._force[self._top :] >= _HELD * largest))
        held = slice(self._top, self._top + int(left[0]) if left.size else self._last + 1)
        creep = relaxation(self._time[held], self._values("real_contact_area")[held])
        half, error = np.array([0.5]), self._values("gross_contact_area_std") / self._area
        (grown, grown_error), (fallen, fallen_error) = (
            [float(_at(half, self._share, values, frames)[0]) for values in (self._area, error)]
            for frames in (self._rising, self._falling)
        )
        return {
            "contact_exponent": growth.exponent,
            "contact_exponent_std": growth.exponent_std,
            "contact_time_constant": creep.exponent,
            "contact_time_constant_std": creep.exponent_std,
            "unloading_area_ratio": fallen / grown,
            "unloading_area_ratio_std": math.hypot(grown_error, fallen_error) * fallen / grown,
        }

    @cached_property
    def _verdict(self) -> dict[str, Any]:
        """Return the verdict on the loss of the stuck area, with NaN where it states nothing."""
        judged = json.loads((self._result[_JUDGED].attrs if _JUDGED in self._result else {}).get("verdict") or "{}")
        return {name: np.nan if value is None else value for name, value in judged.items()}

    @cached_property
    def _slip_loading(self) -> tuple[Series, Series, float, Numbers] | None:
        """Return d² and T/N (frames,), T/N at full slip, and the frames from where it is last under a twentieth of that
        to where the last skin slips; None if it never does.
        """
        stuck, ratio, verdict = self._values(_JUDGED), self._values("load_ratio"), self._verdict
        loss, load = verdict.get("loss_frame", -1), verdict.get("loss_load_ratio", np.nan)
        if loss < 1 or not load > 0:
            return None
        loaded = np.flatnonzero(np.abs(ratio[:loss]) < _LOADED * load)
        return stuck, np.abs(ratio), load, np.arange(int(loaded[-1]) if loaded.size else 0, loss + 1)

    def _full_slip(self) -> dict[str, float]:
        """Return time, T/N and displacement of full slip, and the tangential stiffness while nearly all skin sticks."""
        if (slip := self._slip_loading) is None:
            return {}
        (stuck, _, load, frames), verdict = slip, self._verdict
        begin, loss = int(frames[0]), int(frames[-1])
        shrinking = rate(stuck[: loss + 1], self._time[: loss + 1], self._window)[-1]
        frame_s = float(np.median(np.diff(self._time)))
        deviation = float(np.hypot(frame_s / 12**0.5, verdict["area_noise"] / shrinking))
        numbers = {
            "full_slip_load_ratio": load, "full_slip_load_ratio_std": load * verdict["load_noise"],
            "full_slip_time": self._time[loss] - self._time[begin], "full_slip_time_std": deviation,
        }  # fmt: skip
        if "displacement" in self._result:
            moved = np.asarray(self._result["displacement"].values, dtype=np.float64)
            inside = self._result["in_contact"].values[loss] > 0
            median = nanmedian(np.hypot(*np.moveaxis(moved[: loss + 1, inside] - moved[begin, inside], -1, 0)))
            speed = rate(median, self._time[: loss + 1], self._window)[-1]
            numbers |= {"full_slip_displacement": median[-1], "full_slip_displacement_std": abs(speed) * deviation}
        travel, force = self._values("actuator_position"), self._values("tangential_force")
        early = frames[: int(np.argmax(stuck[frames] < _STUCK))]  # d² is under the limit at full slip
        early = early[np.isfinite(travel[early] + force[early])]
        if early.size >= _FEWEST_SLID and np.ptp(travel[early]) > 0:
            line, covariance = np.polyfit(travel[early], force[early], 1, cov=True)
            numbers |= {"tangential_stiffness": abs(line[0]), "tangential_stiffness_std": covariance[0, 0] ** 0.5}
        return numbers

    def _displacement_numbers(self) -> dict[str, float]:
        contact = slice(self._onset, self._last + 1)
        moved = np.asarray(self._result["displacement"].values[contact], dtype=np.float64)
        length = np.hypot(moved[..., 0], moved[..., 1])
        length[~self._usable[contact]] = np.nan
        length[self._result["in_contact"].values[contact] == 0] = np.nan
        counts = np.isfinite(length).sum(1)
        if not counts.any():
            return {}
        # Take the quantile as the value of one point (the lower neighbour), because the speed of this point is needed
        # too.
        chosen = np.floor(_LARGEST_QUANTILE * np.maximum(counts - 1, 0)).astype(int)
        largest = np.sort(length, axis=1)[np.arange(len(length)), chosen]  # NaN last
        frame = int(np.nanargmax(largest))
        point = int((length[frame] == largest[frame]).argmax())
        speed = np.hypot(*rate(moved[:, point], self._time[contact], self._window).T)[: self._top - self._onset + 1]
        return {"max_displacement": float(largest[frame]), "max_speed": _largest(speed)}

    def facts(self) -> dict[str, Any]:
        """Return the columns of the trial's table row that are no measurements: numbers of frames and usable frames,
        warnings of the processing, and slip verdict (None without one).
        """
        return {
            "frames": len(self._time),
            "usable_frames": int(self._usable.sum()),
            "warnings": "\n".join(json.loads(self._result.attrs["warnings"])),
            "slip_verdict": self._verdict.get("outcome"),
        }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _at(grid: Series, load: Series, series: Series, frames: Numbers) -> Series:
    """Return a series where the load of `frames`, in their order, first reaches each value of `grid`, interpolated
    between two frames; NaN where it does not, or the series is not known there.
    """
    known = frames[np.isfinite(load[frames])]
    if not known.size:
        return grid * np.nan
    after = np.searchsorted(np.maximum.accumulate(load[known]), grid)
    steps = (known[max(end - 1, 0) : end + 1] for end in after)  # of two frames; one before the first, after the last
    return np.array([np.interp(x, load[two], series[two], np.nan, np.nan) for x, two in zip(grid, steps, strict=True)])


def _largest(values: Series) -> float:
    return float(np.nanmax(values)) if np.isfinite(values).any() else np.nan
