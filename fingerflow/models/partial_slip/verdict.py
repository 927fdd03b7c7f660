"""Classification of a trial of tangential loading: does the stuck area vanish abruptly or diminish?"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import median_filter

from fingerflow.models.partial_slip.evolution import friction_ratio
from fingerflow.models.partial_slip.fit import frame_noise

Values = NDArray[np.float64]
Outcome = Literal["vanishes abruptly", "diminishes", "inconclusive"]

CORRIDOR = 0.05  # relative half-width of the corridor around T/N just before the complete loss of adhesion
SMALLEST_AREA = 0.05  # d^2 above which a minimal adhesion area exists
# d^2 of a fading area at the corridor's edge: (1 - T/(mu N))^(1/2) at T/(mu N) = 0.95 for mu_s = mu_k, and less for
# mu_s < mu_k.
FADING_AREA = math.sqrt(CORRIDOR)

_SMOOTHED_S = 0.05  # s of the running medians, and five frames at least
_REFERENCE_S = 0.05  # s before the complete loss over which its T/N is taken
_FEWEST = 15  # frames with d^2 and T/N
_LARGEST_FALL = CORRIDOR  # relative fall of T/N before the complete loss; with more the loading is not slow
_LARGEST_NOISE = CORRIDOR / 2  # standard deviation of T/N from frame to frame
_LARGEST_GAP_S = 0.1  # s without a measurement inside the corridor


@dataclass(frozen=True)
class TrialVerdict:
    """Classification of a trial by `judge_trial`, with the numbers behind it; NaN or -1 if not computable.

    Attributes:
        outcome: "vanishes abruptly", "diminishes" or "inconclusive".
        reason: why, in a sentence.
        printed_outcome: outcome of the rule as printed, with 0.05 as the limit of `corridor_area`.
        loss_frame: index of the first frame from which on d^2 is 0.05 at most, taken as no adhesion.
        loss_load_ratio: T/N just before it.
        corridor_frames: first and last index of the run of frames before the loss with T/N inside the corridor.
        corridor_area: largest d^2 in that run; `corridor_ms`, time from that frame to the loss.
        critical_area: d^2_critic, `corridor_area` without the part explained by slow loading; 0 at least.
        critical_area_std: its standard deviation, as given.
        critical_extent: d, its linear extent.
        collapse_frame: index of the last frame with the critical area.
        collapse_ms: time in which the critical area vanishes: from 0.8 to 0.2 of it, over 0.6, because the first and
            the last part are lost in noise.
        friction_ratio: mu_k / mu_s that the critical area implies; NaN unless the area vanishes abruptly.
        steepest_fall: largest fall of T/N before the loss, relative to `loss_load_ratio`.
        load_noise: standard deviation of T/N from frame to frame, relative to the same.
        frames_measured: frames with both d^2 and T/N; `frames_missing`, frames without one or both.
    """

    outcome: Outcome
    reason: str
    printed_outcome: Outcome
    loss_frame: int = -1
    loss_load_ratio: float = math.nan
    corridor_frames: tuple[int, int] = (-1, -1)
    corridor_area: float = math.nan
    corridor_ms: float = math.nan
    critical_area: float = math.nan
    critical_area_std: float = math.nan
    critical_extent: float = math.nan
    collapse_frame: int = -1
    collapse_ms: float = math.nan
    friction_ratio: float = math.nan
    steepest_fall: float = math.nan
    load_noise: float = math.nan
    frames_measured: int = 0
    frames_missing: int = 0

    def loading(self) -> slice:
        """Return the range of frames of slow loading, before the collapse, to which a friction law may be fitted."""
        return slice(0, self.collapse_frame + 1)


def judge_trial(
    stuck_area: ArrayLike, load_ratio: ArrayLike, time: ArrayLike, critical_area_std: float = 0.0
) -> TrialVerdict:
    """Decide whether a trial has a minimal adhesion area: the corridor rule of Terekhov & Hayward 2011, section 3.

    The rule takes T/N just before the complete loss of adhesion, and the largest d^2 while T/N stays within 5 % of it.
    The paper states that a minimal area exists if that d^2 is above 0.05. There its curve for equal coefficients, d^2 =
    1 - T/(mu N), enters the corridor; but that curve is misprinted (see `stuck_area`): a fading area is
    still (0.05)^(1/2) = 0.224 there. By the same reasoning the model's own d^2 there is c + 0.224 (1 - c), where c is
    the critical one. The rule used here solves for c: a minimal area exists if c > 0.05, that is if the d^2 in the
    corridor is above 0.262. `printed_outcome` holds the rule as printed. The two rules disagree for an area that
    vanishes from less than 0.262 without bending down towards the loss as the model does. It counts as fading here and
    as vanishing abruptly in print: inspect such a trial.

    Both curves are smoothed by running medians over 50 ms, five frames at least, so single wrong frames have no effect.

    Args:
        stuck_area: (F,) d^2 per frame: stuck area over contact area. NaN where it was not measured.
        load_ratio: (F,) T/N. NaN where there are no forces, as after the end of their file.
        time: (F,) s, increasing.
        critical_area_std: standard deviation of the critical area. If it exceeds the distance to the limit of 0.05, the
            trial is "inconclusive", with all its numbers but the ratio of frictions.

    Raises:
        ValueError: the arrays differ in length or have more than one dimension, the time does not increase, or the
            deviation is below 0 or not finite.
    """
    area, load, when = _checked(stuck_area, load_ratio, time)
    if not 0 <= critical_area_std < math.inf:
        raise ValueError(f"critical_area_std must be 0 or more, not {critical_area_std}")
    measured = np.isfinite(area) & np.isfinite(load)
    found = TrialVerdict(
        "inconclusive",
        "",
        "inconclusive",
        frames_measured=int(measured.sum()),
        frames_missing=int((~measured).sum()),
    )
    if found.frames_measured < _FEWEST:
        return replace(found, reason=f"{found.frames_measured} frames have d² and T/N; {_FEWEST} are needed")
    width = max(5, 2 * round(_SMOOTHED_S / float(np.median(np.diff(when))) / 2) + 1)
    area, load = _smoothed(area, width), _smoothed(load, width)
    if np.nanmax(area) < 0.5:
        return replace(found, reason=f"the contact never sticks: d² is {np.nanmax(area):.2f} at most, under 0.5")
    loss = _complete_loss(area)
    if loss is None:
        last = area[np.isfinite(area)][-1]
        return replace(found, reason=f"no full slip: d² is {last:.2f} at the end, over {SMALLEST_AREA}")
    found = replace(found, loss_frame=loss)

    just_before = load[(when >= when[loss] - _REFERENCE_S) & (when < when[loss])]
    if not np.isfinite(just_before).any():
        return replace(found, reason=f"no T/N in the {_REFERENCE_S:g} s before the complete loss at {when[loss]:.3f} s")
    reference = float(np.nanmedian(just_before))
    found = replace(found, loss_load_ratio=reference)
    if reference <= 0:
        return replace(found, reason=f"T/N is {reference:.2f} at the complete loss: the sign of a force is wrong")
    loading = load[: loss + 1][np.isfinite(load[: loss + 1])]
    fall = float((np.maximum.accumulate(loading) - loading).max()) / reference
    noise = frame_noise(np.asarray(load_ratio, float)[: loss + 1]) / reference
    found = replace(found, steepest_fall=fall, load_noise=noise)
    if fall > _LARGEST_FALL:
        return replace(
            found, reason=f"T/N is too unsteady: it falls by {fall:.0%} before the loss, over {_LARGEST_FALL:.0%}"
        )
    if noise > _LARGEST_NOISE:
        return replace(found, reason=f"T/N is too noisy: {noise:.1%} from frame to frame, over {_LARGEST_NOISE:.1%}")

    run = _corridor_run(np.where(np.isfinite(area), load, np.nan), loss, reference)
    if run.size == 0:
        return replace(found, reason="no frame before the complete loss has T/N inside the corridor")
    found = replace(found, corridor_frames=(int(run[0]), int(run[-1])))
    gap = float(np.diff(when[np.append(run, loss)]).max())
    if gap > _LARGEST_GAP_S:
        return replace(found, reason=f"{gap:.2f} s without d² or T/N inside the corridor, over {_LARGEST_GAP_S:g} s")
    if not np.isfinite(load[: run[0]]).any():
        return replace(found, reason="T/N is inside the corridor from the first frame on: no loading was recorded")
    return _judged(replace(found, critical_area_std=critical_area_std), area, when, run)


def _judged(found: TrialVerdict, area: Values, when: Values, run: NDArray[np.intp]) -> TrialVerdict:
    loss = found.loss_frame
    largest = float(area[run].max())
    critical = max((largest - FADING_AREA) / (1 - FADING_AREA), 0.0)
    abrupt = critical > SMALLEST_AREA
    outcome: Outcome = "vanishes abruptly" if abrupt else "diminishes"
    against = f"{'over' if abrupt else 'not over'} {SMALLEST_AREA:g}"
    if abs(critical - SMALLEST_AREA) < found.critical_area_std:
        outcome = "inconclusive"
        against = f"which with its standard deviation of {found.critical_area_std:g} is not told from {SMALLEST_AREA:g}"
    known = np.flatnonzero(np.isfinite(area[:loss]))
    last = int(known[area[known] >= critical][-1]) if abrupt else int(known[-1])
    number = (
        f"d² of {largest:.2f} inside the corridor, {FADING_AREA:.3f} of an area that fades: {critical:.2f} critical"
    )
    return replace(
        found,
        outcome=outcome,
        reason=f"{number}, {against}",
        printed_outcome="vanishes abruptly" if largest > SMALLEST_AREA else "diminishes",
        corridor_area=largest,
        corridor_ms=1000 * float(when[loss] - when[run[area[run].argmax()]]),
        critical_area=critical,
        critical_extent=math.sqrt(critical),
        collapse_frame=last,
        collapse_ms=_collapse_ms(area[: loss + 1], when, critical) if abrupt else math.nan,
        friction_ratio=float(friction_ratio(critical)) if outcome == "vanishes abruptly" else math.nan,
    )


def _collapse_ms(area: Values, when: Values, critical: float) -> float:
    known = np.flatnonzero(np.isfinite(area))
    high, low = (known[area[known] >= share * critical][-1] for share in (0.8, 0.2))
    return 1000 * float(when[low] - when[high]) / 0.6


def _checked(*arrays: ArrayLike) -> tuple[Values, Values, Values]:
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
    """Return the running median of a series over its finite values; other values stay NaN."""
    result = np.full(values.shape, np.nan)
    finite = np.isfinite(values)
    result[finite] = median_filter(values[finite], size=width, mode="nearest")
    return result


def _complete_loss(area: Values) -> int | None:
    """Return the first frame from which on the stuck area share d^2 is 0.05 or less up to the end; None if none."""
    known = np.flatnonzero(np.isfinite(area))
    still = np.flatnonzero(area[known] > SMALLEST_AREA)
    after = still[-1] + 1 if still.size else 0
    return int(known[after]) if after < known.size else None


def _corridor_run(load: Values, loss: int, reference: float) -> NDArray[np.intp]:
    """Return the frames just before the loss of adhesion in which T/N stays inside the corridor around `reference`."""
    known = np.flatnonzero(np.isfinite(load[:loss]))
    outside = np.flatnonzero(np.abs(load[known] / reference - 1) > CORRIDOR)
    return known[outside[-1] + 1 :] if outside.size else known
