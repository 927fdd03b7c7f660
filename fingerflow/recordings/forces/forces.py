"""Force channels with separate sample times: alignment to the trigger, and resampling at the times of the frames."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fingerflow.errors import FingerflowError
from fingerflow.recordings.forces.low_pass import low_pass

Samples = NDArray[np.float64]
_LEAST_SAMPLES = 4  # within the frames, from which their forces can be interpolated at all
# Duration of forces in that of the frames above which forces sampled less often than frames, and below which all, are
# taken to be in another unit of time.
_LONGEST, _SHORTEST = 50.0, 0.05


@dataclass(frozen=True, eq=False)
class Forces:
    """Force channels that share one series of sample times.

    `times`: (n,) s, strictly increasing, not necessarily even. `channels`: name -> (n,) in the unit of `units` ("N",
    "V", "m", or "" for a trigger without unit). `trigger`: name of the trigger's channel or None. `scales`: factors
    from the numbers in the file to `units`, 1 if left out. `warnings`: sentences for the user; `resample` adds to them.

    Raises FingerflowError for times that are not finite or do not increase, and for channels of another length.
    """

    path: Path
    times: Samples
    channels: Mapping[str, Samples]
    units: Mapping[str, str]
    trigger: str | None = None
    scales: Mapping[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.times.ndim != 1 or self.times.size == 0:
            raise FingerflowError(f"{self.path}: has no samples")
        finite = np.isfinite(self.times)
        if not finite.all():
            row = int(finite.argmin())
            raise FingerflowError(
                f"{self.path}: the time of sample {row} is {self.times[row]}; every sample needs a time"
            )
        if (wrong := np.diff(self.times) <= 0).any():
            row = int(wrong.argmax())
            raise FingerflowError(
                f"{self.path}: sample {row + 1} is not later than the one before ({self.times[row + 1]:g} s after "
                f"{self.times[row]:g} s; {wrong.sum()} such places). Times must increase; "
                "if their digits are too few, give sample_rate in Hz"
            )
        for name, values in self.channels.items():
            if values.shape != self.times.shape:
                raise FingerflowError(
                    f"{self.path}: channel {name!r} has {values.size} samples for {self.times.size} times"
                )

    def align(self, trigger_level: float) -> "Forces":
        """Return the forces with the sample times shifted so that the trigger channel first rises through
        `trigger_level` at 0 s.

        The instant is interpolated linearly between the last sample below the level and the first one not below it.
        Raises FingerflowError if there is no trigger channel or it never rises through the level.
        """
        if self.trigger is None:
            names = ", ".join(map(repr, self.channels))
            raise FingerflowError(f"{self.path}: no trigger channel was named; pass trigger= with one of {names}")
        signal = self.channels[self.trigger]
        rising = np.flatnonzero((signal[:-1] < trigger_level) & (signal[1:] >= trigger_level))
        if rising.size == 0:
            raise FingerflowError(
                f"{self.path}: trigger {self.trigger!r} never rises through {trigger_level:g}; it starts at "
                f"{signal[0]:g} and lies between {np.nanmin(signal):g} and {np.nanmax(signal):g}; "
                "correct [forces] trigger_level or trigger"
            )
        before = int(rising[0])
        part = (trigger_level - signal[before]) / (signal[before + 1] - signal[before])
        instant = self.times[before] + part * (self.times[before + 1] - self.times[before])
        return replace(self, times=self.times - instant, warnings=list(self.warnings))

    def resample(self, frame_times: ArrayLike) -> dict[str, Samples]:
        """Return all channels, by name, resampled at the times of the frames after a low-pass filter that ends at half
        the frame rate.

        frame_times: (m,) s on the same clock, in any order. Each value is a weighted mean of the samples around the
        frame; the weights are a zero-phase low-pass filter that ends at half the frame rate (see `low_pass`). Forces
        that are sampled no faster than the frames are interpolated linearly instead, with a warning.

        Frames outside the time span of the forces, or in a gap between samples that is longer than a frame, get NaN;
        their number is added to `warnings`. Samples that are NaN or infinite count as missing. Raises FingerflowError
        if all frames lie outside.
        """
        targets = np.asarray(frame_times, np.float64)
        if targets.ndim != 1 or targets.size == 0 or not np.isfinite(targets).all():
            raise FingerflowError(
                f"{self.path}: frame times are one finite number a frame, in s; an array {targets.shape} was given"
            )
        first, last = self.times[0], self.times[-1]
        if not ((targets >= first) & (targets <= last)).any():
            raise FingerflowError(
                f"{self.path}: forces last from {first:g} to {last:g} s, the frames from {targets.min():g} to "
                f"{targets.max():g} s: no frame is covered. Count both from one instant, or give [forces] trigger"
            )
        within = int(np.sum((self.times >= targets.min()) & (self.times <= targets.max())))
        lasts, span = float(np.ptp(self.times)), float(np.ptp(targets))
        sparse = (_rate(self.times) or 0.0) < (_rate(targets) or 0.0) and lasts > _LONGEST * span
        if targets.size > _LEAST_SAMPLES and (within < _LEAST_SAMPLES or sparse or lasts < _SHORTEST * span):
            raise FingerflowError(
                f"{self.path}: the forces last {lasts:.3g} s, the {targets.size} frames {span:.3g} s, and {within} "
                "samples lie within them: is the unit of the times right? Write it in the heading, 'time (ms)', or "
                "give the sample_rate; check recording.frame_rate"
            )
        # Samples that are not finite count as missing; channels that lack the same samples are filtered together.
        lacking: dict[bytes, list[str]] = {}
        for name, values in self.channels.items():
            lacking.setdefault(np.isfinite(values).tobytes(), []).append(name)
        result = {}
        for mask, names in lacking.items():
            present = np.frombuffer(mask, dtype=bool)
            if not present.any():
                self._warn(f"{', '.join(names)}: no sample is a number; NaN in all frames")
                result.update({name: np.full(targets.size, np.nan) for name in names})
                continue
            values = np.stack([self.channels[name][present] for name in names])
            result.update(zip(names, self._resample_channels(self.times[present], values, targets), strict=True))
        return {name: result[name] for name in self.channels}

    def _resample_channels(self, times: Samples, values: Samples, targets: Samples) -> Samples:
        """Resample channels (k, n), sampled at `times` (n,), at the frame times `targets` (m,); return them as (k, m),
        with NaN outside the record and in gaps between samples.
        """
        frame_rate, sample_rate = _rate(targets), _rate(times)
        # A sample represents half a step on both sides, so the record covers half a step before its first and after its
        # last sample. A trigger that rises within a step puts a frame at the very end of it: 1 % of a step is rounding.
        margin = 0.0 if sample_rate is None else 0.505 / sample_rate
        covered = (targets >= times[0] - margin) & (targets <= times[-1] + margin)
        if not covered.all():
            question = "is the trigger right?"
            self._warn(f"the forces do not cover {(~covered).sum()} of {targets.size} frames (NaN there): {question}")
        if frame_rate is not None and sample_rate is not None and sample_rate > frame_rate:
            after = np.clip(np.searchsorted(times, targets), 1, times.size - 1)
            in_gap = covered & (times[after] - times[after - 1] > 1 / frame_rate)
            if in_gap.any():
                self._warn(f"the forces have gaps at {in_gap.sum()} of {targets.size} frames (NaN there)")
                covered &= ~in_gap
            at_frames = low_pass(times, values, targets[covered], nyquist=frame_rate / 2)
        else:
            stated = sample_rate and frame_rate
            rates = f"forces at {sample_rate:g} Hz, frames at {frame_rate:g} Hz" if stated else "one time"
            self._warn(f"forces are sampled no faster than the frames ({rates}): interpolated linearly, not filtered")
            at_frames = np.stack([np.interp(targets[covered], times, row) for row in values])
        result = np.full((len(values), targets.size), np.nan)
        result[:, covered] = at_frames
        return result

    def _warn(self, sentence: str) -> None:
        if sentence not in self.warnings:
            self.warnings.append(sentence)


def _rate(times: Samples) -> float | None:
    """Return the sample rate in Hz from the median interval between times; None for fewer than two times."""
    steps = np.diff(np.sort(times))
    steps = steps[steps > 0]
    return 1.0 / float(np.median(steps)) if steps.size else None
