"""Classification of a trial of tangential loading: does the stuck area vanish abruptly or diminish?"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import median_filter

from fingerflow.models.partial_slip.collapse import Collapse, fit_collapse
from fingerflow.models.partial_slip.evolution import critical_load_ratio, friction_ratio
from fingerflow.models.partial_slip.fit import FrictionFit, frame_noise

Values = NDArray[np.float64]
Outcome = Literal["vanishes abruptly", "diminishes", "inconclusive"]

CORRIDOR = 0.05  # relative half-width of the corridor around T/N just before the complete loss of adhesion
SMALLEST_AREA = 0.05  # least d^2 at the collapse that counts as a minimal adhesion area
# d^2 at the corridor's edge of an area that fades: (1 - T/(mu N))^(1/2) at T/(mu N) = 0.95 for mu_s = mu_k, and less
# for mu_s < mu_k.
FADING_AREA = math.sqrt(CORRIDOR)

_NEAR_LOSS = f"within {CORRIDOR:.0%} of that at the loss"  # in reasons: the corridor of the paper
_SMOOTHED_S = 0.05  # s, window of the running medians, at least five frames
_REFERENCE_S = 0.05  # s before the complete loss in which a T/N must be known
_FEWEST = 15  # least number of frames with d^2 and T/N
# Largest relative fall of T/N before the complete loss; a larger one means that the loading is not slow.
_LARGEST_FALL = CORRIDOR
_LARGEST_NOISE = CORRIDOR / 2  # largest standard deviation of T/N from frame to frame, relative
_LARGEST_GAP_S = 0.1  # s, longest gap without a measurement inside the corridor
_LEAST_ZERO = 0.01  # least d^2 that counts as 0, also without measured noise
_ZERO_STD = 4.0  # d^2 up to this many standard deviations of its smoothed values counts as 0
_LARGEST_STD = 2.0  # standard deviations by which the largest of several d^2 exceeds the true one
_LEAST_EVIDENCE = 6.0  # least chi^2 by which a collapse must explain d^2 better than fading: 2.4 standard deviations


@dataclass(frozen=True)
class TrialVerdict:
    """Result of `judge_trial`: whether the stuck area of a trial vanishes abruptly or diminishes, and the quantities
    from which this follows; NaN or -1 if not computable.

    Attributes:
        outcome: "vanishes abruptly", "diminishes" or "inconclusive".
        reason: why, in a sentence.
        printed_outcome: outcome of the paper's rule, by `corridor_area`.
        model_outcome: outcome by `model_area`.
        loss_frame: index of the first frame from which on d^2 is 0 up to its noise, `zero_area`.
        zero_area: d^2 that is not distinguished from 0; `area_noise`, standard deviation of the smoothed d^2.
        loss_load_ratio: T/N just before the loss.
        corridor_frames: first and last index of the run of frames before the loss with T/N inside the corridor.
        corridor_area: largest d^2 in that run; `corridor_ms`, time from that frame to the loss.
        model_area: the critical area that equation 5 implies for `corridor_area`; 0 at least.
        critical_area: d^2_critic, at which d^2 no longer follows the load; `critical_area_std`, its standard deviation.
        critical_extent: d, its linear extent.
        collapse_frame: index of the last frame before the collapse; where the area fades, before the loss.
        collapse_ms: time in which the critical area vanishes; `collapse_ms_std`, its standard deviation.
        collapse_rate: d^2 per second during the collapse; `collapse_rate_std`, its standard deviation.
        collapse_evidence: chi^2 by which a collapse at constant load explains d^2 better than fading does.
        friction_ratio: mu_k / mu_s that the critical area implies; NaN unless the area vanishes abruptly.
        steepest_fall: largest fall of T/N before the loss, relative to `loss_load_ratio`.
        load_noise: standard deviation of T/N from frame to frame, relative to the same.
        frames_measured: frames with both d^2 and T/N; `frames_missing`, frames without one or both.
    """

    outcome: Outcome
    reason: str
    printed_outcome: Outcome
    model_outcome: Outcome = "inconclusive"
    loss_frame: int = -1
    zero_area: float = math.nan
    area_noise: float = math.nan
    loss_load_ratio: float = math.nan
    corridor_frames: tuple[int, int] = (-1, -1)
    corridor_area: float = math.nan
    corridor_ms: float = math.nan
    model_area: float = math.nan
    critical_area: float = math.nan
    critical_area_std: float = math.nan
    critical_extent: float = math.nan
    collapse_frame: int = -1
    collapse_ms: float = math.nan
    collapse_ms_std: float = math.nan
    collapse_rate: float = math.nan
    collapse_rate_std: float = math.nan
    collapse_evidence: float = math.nan
    friction_ratio: float = math.nan
    steepest_fall: float = math.nan
    load_noise: float = math.nan
    frames_measured: int = 0
    frames_missing: int = 0

    def loading(self) -> slice:
        """Return the slice of the frames before the collapse, in which the load rises slowly and to which a friction
        law may be fitted.
        """
        return slice(0, self.collapse_frame + 1)

    def check_fit(self, fit: FrictionFit) -> FrictionFit:
        """Return a friction fit to the trial's loading, not identified where its curve contradicts this verdict.

        Equation 5 fits a straight line exactly, with mu_k = 2 mu_s and no minimal area, whatever the area at which the
        line ends. It must lose adhesion at the measured T/N to 5 %, and at the measured d^2 (0 where that diminishes)
        to 0.05 or two deviations outside of its interval.
        """
        if not fit.identified:
            return fit
        load = float(critical_load_ratio(fit.mu_s, fit.mu_k))
        abrupt = self.outcome == "vanishes abruptly"
        area, (low, high) = self.critical_area if abrupt else 0.0, fit.critical_area_interval
        off = max(low - area, area - high)
        judged = self.outcome != "inconclusive" and off > max(SMALLEST_AREA, 2 * self.critical_area_std * abrupt)
        if abs(load / self.loss_load_ratio - 1) <= CORRIDOR and not judged:
            return fit
        reason = (
            f"the fitted curve, μk/μs {fit.ratio:.2f}, loses adhesion at T/N {load:.2f} and d² "
            f"{fit.critical_area:.2f}, the trial did at {self.loss_load_ratio:.2f} and {area:.2f}: d² is not that of "
            "the model; try a smaller [slip] stuck_mm"
        )
        return replace(fit, identified=False, reason=reason)


def judge_trial(
    stuck_area: ArrayLike, load_ratio: ArrayLike, time: ArrayLike, area_std: ArrayLike | None = None
) -> TrialVerdict:
    """Decide by three rules whether the stuck area of a trial shrinks to a minimal area and then vanishes abruptly.

    `outcome` assumes no friction law. `fit_collapse` finds the d^2 at which the stuck area stops following the load and
    collapses. The area vanishes abruptly if this d^2 exceeds 0.05 and its standard deviation, and if a collapse
    explains d^2 better than fading by a chi^2 of 6. Otherwise it diminishes; it is inconclusive where d^2 exceeds 0.05
    but not its deviation.

    `printed_outcome` is the rule of Terekhov & Hayward 2011, section 3: the largest d^2 while T/N stays within 5 % of
    its value just before the complete loss of adhesion; a minimal area exists if that is above 0.05. There the paper's
    line for equal coefficients, d^2 = 1 - T/(mu N), enters the corridor, so the line itself diminishes. At the loss d^2
    is 0 up to `zero_area`, and the largest value has an error of two deviations; the limit is raised by both.

    `model_outcome` corrects that limit: the line is misprinted (see `stuck_area`), and a fading area is still
    (0.05)^(1/2) = 0.224 there. By equation 5 the d^2 there is c + 0.224 (1 - c), where c is the critical one. The area
    vanishes abruptly if c, `model_area`, is above 0.05. A trial that does not bend down as the model does is misjudged.

    Both curves are smoothed by running medians over 50 ms, five frames at least, so single wrong frames have no effect.

    Args:
        stuck_area: (F,) d^2 per frame: stuck area over contact area. NaN where it was not measured.
        load_ratio: (F,) T/N. NaN where there are no forces, as after the end of their file.
        time: (F,) s, increasing.
        area_std: (F,) standard deviation of d^2 that all frames share. It adds to the deviations of the critical area
            and of the rate; NaN adds nothing.

    Raises:
        ValueError: the arrays differ in length or have more than one dimension, or the time does not increase.
    """
    area, load, when = _check_curves(stuck_area, load_ratio, time)
    measured = np.isfinite(area) & np.isfinite(load)
    verdict = TrialVerdict("inconclusive", "", "inconclusive")
    verdict = replace(verdict, frames_measured=int(measured.sum()), frames_missing=int((~measured).sum()))
    if verdict.frames_measured < _FEWEST:
        return replace(
            verdict, reason=f"d² and T/N are known in {verdict.frames_measured} frames; {_FEWEST} are needed"
        )
    width = max(5, 2 * round(_SMOOTHED_S / float(np.median(np.diff(when))) / 2) + 1)
    raw, area, load = area, _smoothed(area, width), _smoothed(load, width)
    if np.nanmax(area) < 0.5:
        return replace(verdict, reason=f"the contact never sticks: d² is {np.nanmax(area):.2f} at most, under 0.5")
    noise = _area_noise(raw, area, width)
    zero = max(_LEAST_ZERO, _ZERO_STD * noise)
    loss = _complete_loss(area, zero)
    if loss is None:
        last = area[np.isfinite(area)][-1]
        return replace(verdict, reason=f"no full slip: d² is {last:.2f} at the end, above its noise of {zero:.2f}")
    verdict = replace(verdict, loss_frame=loss, zero_area=zero, area_noise=noise)

    just_before = load[(when >= when[loss] - _REFERENCE_S) & (when < when[loss])]
    if not np.isfinite(just_before).any():
        return replace(
            verdict, reason=f"no T/N in the {_REFERENCE_S:g} s before the complete loss at {when[loss]:.3f} s"
        )
    # T/N may fall from the loss on, so the larger value is taken.
    reference = float(np.fmax(just_before[np.isfinite(just_before)][-1], load[loss]))
    verdict = replace(verdict, loss_load_ratio=reference)
    if reference <= 0:
        return replace(verdict, reason=f"T/N is {reference:.2f} at the complete loss: the sign of a force is wrong")
    loading = load[: loss + 1][np.isfinite(load[: loss + 1])]
    fall = float((np.maximum.accumulate(loading) - loading).max()) / reference
    noise = frame_noise(np.asarray(load_ratio, float)[: loss + 1]) / reference
    verdict = replace(verdict, steepest_fall=fall, load_noise=noise)
    if fall > _LARGEST_FALL:
        reason = f"T/N is too unsteady: it falls by {fall:.0%} before the loss, over {_LARGEST_FALL:.0%}"
        return replace(verdict, reason=reason)
    if noise > _LARGEST_NOISE:
        return replace(verdict, reason=f"T/N is too noisy: {noise:.1%} from frame to frame, over {_LARGEST_NOISE:.1%}")

    run = _corridor_run(np.where(np.isfinite(area), load, np.nan), loss, reference)
    if run.size == 0:
        return replace(verdict, reason=f"no frame before the complete loss has a T/N {_NEAR_LOSS}")
    verdict = replace(verdict, corridor_frames=(int(run[0]), int(run[-1])))
    gap = float(np.diff(when[np.append(run, loss)]).max())
    if gap > _LARGEST_GAP_S:
        reason = f"d² or a T/N {_NEAR_LOSS} is unknown for {gap:.2f} s, longer than {_LARGEST_GAP_S:g} s"
        return replace(verdict, reason=reason)
    if not np.isfinite(load[: run[0]]).any():
        return replace(verdict, reason=f"T/N is {_NEAR_LOSS} from the first frame on: no loading was recorded")
    collapse = fit_collapse(area, load, when, loss)
    if collapse is None:
        return replace(verdict, reason="d² and T/N are known in too few frames about the complete loss")
    if area_std is not None:
        shared = np.nan_to_num(np.interp(collapse.begin, when, np.asarray(area_std, dtype=np.float64)))
        collapse = replace(
            collapse,
            area_std=math.hypot(collapse.area_std, shared),
            rate_std=math.hypot(collapse.rate_std, shared * collapse.rate / max(collapse.area, _LEAST_ZERO)),
        )
    return _complete_verdict(verdict, collapse, area, when, run)


def _complete_verdict(
    verdict: TrialVerdict, collapse: Collapse, area: Values, when: Values, run: NDArray[np.intp]
) -> TrialVerdict:
    """Complete a `verdict` with its outcomes, from the fitted collapse, the smoothed stuck area share `area` at
    times `when` (s), and the frames `run` before the loss of adhesion in which T/N hardly changes.
    """
    loss = verdict.loss_frame
    largest = float(area[run].max())
    model = max((largest - FADING_AREA) / (1 - FADING_AREA), 0.0)
    critical, evidence = collapse.area, collapse.evidence
    outcome: Outcome = "diminishes"
    against = f"not above {SMALLEST_AREA:g}"
    if critical > SMALLEST_AREA:
        against = f"above {SMALLEST_AREA:g}"
        if evidence <= _LEAST_EVIDENCE:
            against += f", but fading explains it as well (χ² {evidence:.0f} of {_LEAST_EVIDENCE:.0f})"
        elif critical <= collapse.area_std:
            outcome, against = "inconclusive", against + ", but less than its standard deviation"
        else:
            outcome = "vanishes abruptly"
    abrupt = outcome == "vanishes abruptly"
    valid = np.flatnonzero(np.isfinite(area[:loss]))
    following = valid[when[valid] <= collapse.begin] if abrupt else valid
    return replace(
        verdict,
        outcome=outcome,
        reason=(
            f"stick ratio d² {largest:.2f} when the load reached {1 - CORRIDOR:.0%}, {FADING_AREA:.2f} had it faded; "
            f"critical d² {critical:.2f} ± {collapse.area_std:.2f}, {against}"
        ),
        printed_outcome=_judge_area(largest - verdict.zero_area - _LARGEST_STD * verdict.area_noise),
        model_outcome=_judge_area(model),
        corridor_area=largest,
        corridor_ms=1000 * float(when[loss] - when[run[area[run].argmax()]]),
        model_area=model,
        critical_area=critical,
        critical_area_std=collapse.area_std,
        critical_extent=math.sqrt(critical),
        collapse_frame=int(following[-1]) if following.size else -1,
        collapse_ms=1000 * collapse.duration if abrupt else math.nan,
        collapse_ms_std=1000 * collapse.duration_std if abrupt else math.nan,
        collapse_rate=collapse.rate,
        collapse_rate_std=collapse.rate_std,
        collapse_evidence=evidence,
        friction_ratio=float(friction_ratio(critical)) if abrupt else math.nan,
    )


def _judge_area(area: float) -> Outcome:
    return "vanishes abruptly" if area > SMALLEST_AREA else "diminishes"


def _check_curves(*arrays: ArrayLike) -> tuple[Values, Values, Values]:
    area, load, when = (np.asarray(values, dtype=np.float64) for values in arrays)
    if not area.shape == load.shape == when.shape or area.ndim != 1:
        raise ValueError(
            f"d², T/N and time have shapes {area.shape}, {load.shape} and {when.shape}: give one value a frame "
            "of each, NaN where one was not measured"
        )
    if not (np.diff(when) > 0).all() or not np.isfinite(when).all():
        raise ValueError("the time does not increase from frame to frame: sort the frames, leave out repeated ones")
    return area, load, when


def _smoothed(values: Values, width: int) -> Values:
    """Return the running median, over `width` values, of the finite values of a series; others become NaN."""
    result = np.full(values.shape, np.nan)
    finite = np.isfinite(values)
    result[finite] = median_filter(values[finite], size=width, mode="nearest")
    return result


def _area_noise(raw: Values, smoothed: Values, width: int) -> float:
    """Return the noise (standard deviation) that a running median over `width` frames leaves in the stuck area share
    d^2, from the `raw` values in frames of partial slip; 0 if these are too few.
    """
    noise = frame_noise(raw[(smoothed > 0.05) & (smoothed < 0.95)])
    # Standard deviation of the median of `width` independent values.
    return math.sqrt(math.pi / 2 / width) * noise if math.isfinite(noise) else 0.0


def _complete_loss(area: Values, zero: float) -> int | None:
    """Return the frame from which on the stuck area share d^2 stays at 0, that is at most `zero`, with the fewest
    exceptions before and after it; None if it never is.
    """
    valid = np.flatnonzero(np.isfinite(area))
    above = area[valid] > zero
    exceptions = np.append(0, np.cumsum(~above)) + np.append(np.cumsum(above[::-1])[::-1], 0)
    first = int(exceptions.argmin())
    return int(valid[first]) if first < valid.size else None


def _corridor_run(load: Values, loss: int, reference: float) -> NDArray[np.intp]:
    """Return the indices of the frames directly before `loss`, the frame at which adhesion is lost, in which the load
    ratio T/N stays within 5 % of `reference`.
    """
    valid = np.flatnonzero(np.isfinite(load[:loss]))
    outside = np.flatnonzero(np.abs(load[valid] / reference - 1) > CORRIDOR)
    return valid[outside[-1] + 1 :] if outside.size else valid
