"""A simulated study with known truth: skin of two stiffnesses, friction by condition, observer of known sensitivity.

The observer perceives, with noise, what a camera measures: the median divergence over the contact area since each
point's onset, at the largest force, of the skin chain (Willemet et al. 2021) that is recorded. It answers "more
slippery" if that exceeds a criterion. Above a friction of 0.2 less friction gives more divergence; below, the edge of
the contact slides outward as a whole, and the median by area no longer rises.
"""

import csv
import io
import json
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fingerflow.results.atomic_write import write_atomically
from fingerflow.synthetic import Camera, ChainPress, write_recording

Values = NDArray[np.float64]
_LOAD_N = 3.0
_FRAMES, _FRAME_SHAPE, _FINGER, _MM_PER_PX = 40, (300, 600), (6.0, 6.0), 0.04  # contacts of up to 10 mm


@dataclass(frozen=True)
class Design:
    """Design of a simulated study: numbers of trials, vibration, friction, softness of skin, and observer.

    Attributes:
        participants: the second half of them has softer skin.
        trials: of each participant in each condition.
        amplitudes: µm of vibration, one per condition.
        friction: coefficient without vibration, and at the largest amplitude; between them it falls geometrically.
        softness: of firmer and softer skin: divisors of the chain's printed stiffnesses (5.6 gives the printed area).
        criterion: divergence above which the observer answers "more slippery".
        noise: standard deviation of the perceived divergence.
        seed: of all random numbers.
    """

    participants: int = 16
    trials: int = 14
    amplitudes: tuple[float, ...] = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
    friction: tuple[float, float] = (0.9, 0.2)
    softness: tuple[float, float] = (4.5, 7.0)
    criterion: float = 0.004
    noise: float = 0.002
    seed: int = 0

    @cached_property
    def frictions(self) -> Values:
        """Return the friction coefficient of each of C conditions, (C,)."""
        low, high = self.friction
        amplitudes = np.asarray(self.amplitudes)
        result: Values = low * (high / low) ** (amplitudes / max(amplitudes.max(), 1e-9))
        return result

    def is_soft(self) -> NDArray[np.bool_]:
        """Return a mask (P,) of the participants with softer skin."""
        return np.arange(self.participants) >= self.participants // 2


def write_recordings(folder: Path, design: Design) -> None:
    """Write one `ChainPress` recording per trial with its scene, `answers.csv` and `truth.json`, into a new folder.

    A trial's divergence varies through its force, 3 N with a standard deviation of a tenth.

    Raises FingerflowError if a recording cannot be written.
    """
    draw = np.random.default_rng(design.seed)
    rows = []
    for number in range(design.participants):
        softness = design.softness[int(design.is_soft()[number])]
        for place, (amplitude, friction) in enumerate(zip(design.amplitudes, design.frictions, strict=True)):
            for repeat in range(design.trials):
                trial = place * design.trials + repeat + 1
                load = _LOAD_N * min(max(1 + 0.1 * draw.standard_normal(), 0.7), 1.2)
                recorded = ChainPress(
                    friction=float(friction), softness=softness, force=load, n_frames=_FRAMES, frame_rate=_FRAMES,
                    frames_before_trigger=2, frame_shape=_FRAME_SHAPE, finger=_FINGER, mm_per_px=_MM_PER_PX,
                    elements=501, camera=Camera(seed=int(draw.integers(1 << 30))),
                )  # fmt: skip
                felt = float(recorded.chain_since_onset.area_median[-1])
                name = f"p{number + 1:02d}/{amplitude:g}um/trial{trial:03d}"
                write_recording(folder / name, recorded)
                answer = bool(answers_of(design, np.array([felt]), draw)[0])
                rows.append((f"{number + 1:02d}", f"{trial:03d}", int(answer), f"{friction:.4g}", f"{softness:g}"))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("participant", "trial", "answer", "true_friction", "true_softness"))
    writer.writerows(rows)
    write_atomically(folder / "answers.csv", lambda part: part.write_text(text.getvalue(), encoding="utf-8"))
    write_atomically(folder / "truth.json", lambda part: part.write_text(json.dumps(asdict(design)), encoding="utf-8"))


def answers_of(design: Design, divergence: Values, draw: np.random.Generator) -> NDArray[np.bool_]:
    """Return the answers (T,) of a simulated observer: True for the trials that are felt as more slippery."""
    felt = divergence + design.noise * draw.standard_normal(divergence.size)
    return np.asarray(felt > design.criterion)
