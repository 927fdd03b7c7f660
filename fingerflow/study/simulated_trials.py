"""Simulated trials of a study: random parameters of each press, and the answers of a simulated observer.

A trial is a two-interval forced choice of Willemet et al. 2021: a reference press without vibration, and a comparison
press at one of six amplitudes. Each number that is drawn has its source in `Design`; B34 and so on are the printed
values of that paper's supplement.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import ndtri

from fingerflow.models.skin_chain import PressedChain, follow
from fingerflow.models.skin_onset import since_onset
from fingerflow.models.skin_parameters import PARAMETERS
from fingerflow.synthetic import Camera, ChainPress
from fingerflow.synthetic.chain_press import PATH_N_S, force_share

Values = NDArray[np.float64]

_ELEMENTS = 501
_SHARES = 0.17, 0.8  # least and largest share of touching ridges; with less a ridge would be two pixels wide or less
_SKIN = "fitted"  # parameters of the chain
# Of the chains whose divergence and area the observer feels: with 501 elements and 5e-8 m they take twenty times as
# long.
_TIMES, _FEW_ELEMENTS, _TOLERANCE_M = 129, 251, 5e-7


@dataclass(frozen=True)
class Design:
    """Settings of a simulated study: numbers of trials, and distributions of the parameters of its presses.

    Attributes:
        participants: their mean forces are quantiles.
        trials: pairs of presses of each participant in each condition: F(5,70) and F(6,1593) of B54 and B42 fit 15
            participants, six amplitudes beside the reference, and nine pairs.
        amplitudes: µm of vibration of the comparison, one per condition; the reference has none.
        friction: coefficient without vibration and at the largest amplitude (not printed). Vibration lifts skin off
            its junctions (Wiertlewski et al. 2016): friction falls by the share by which the real area does. From 0.4
            to 0.25 skin hardly slips, and nothing is felt. The largest angles are cut: without vibration their standard
            deviation is 4.1 degrees. The logarithm of friction falls with the square root of the amplitude.
        softness: levels of the divisor of the stiffnesses of the fitted tissue; the membrane is that of literature. A
            person has the level next to the mean force of all over their own: all compress their tissue about alike.
            Their apparent areas then spread by 6 mm², 4.5 printed (B5), while their forces spread by 45 %. Drawn apart
            from the force, softness of 0.7 and 1.4 spreads them by 10 mm², with presses that store twice as much.
        force: mean of the peak force, N (B34), and standard deviations of its logarithm over participants, over the
            pairs of one, and between the presses of a pair, in force and in time (not printed: force does not predict
            answers, B37, so pairs are alike).
        force_range: N, outside of which a trial is drawn again (B34).
        time_to_peak: mean and standard deviation, s (B35), normal.
        duration: shortest and longest time from first contact to the last frame, s (B36).
        hold: shortest and longest time for which the peak is held, s (not printed).
        angle: mean angle of the force in degrees without vibration and at the largest amplitude (B43, B44); linear
            between them. Gamma distributed, standard deviation half of the mean as printed.
        displacement: mean and standard deviation of the global displacement, mm (B40), lognormal up to 0.5 mm, drawn
            apart from the angle.
        real_area: mean over presses of the real contact area at the peak, mm² (B6), and its standard deviation over
            participants of one apparent area: with the spread of that area 4.5 mm², as printed.
        real_area_fall: share by which vibration at the largest amplitude reduces it (B8), linear in the amplitude.
        real_area_noise: relative standard deviation from press to press (not printed: with it Spearman's rho of slope
            and amplitude is -0.28, B7).
        noise: standard deviation of the difference of divergence at the peak, as the observer perceives it (not
            printed: with it five of six answers are right).
        felt_rate: N/s, rate r of the force at which evidence counts by 1 - 1/e, as 1 - exp(-rate / r) (B39: faster
            presses are answered better).
        cues: weights, in standard deviations of the noise, of a smaller force angle (1/rad) and of a larger
            displacement of the finger (1/mm): a quarter and a half for their usual differences (B45, B41: with half
            of this, displacement and answers have a rho of -0.08, 0.14 printed).
        frame_rate: frames per second; the lab has 300 (B12).
        mm_per_px: of the contact view (B12): skin that is spread by low friction is lost in coarser pictures.
        view_px: side of either view, both are square.
        seed: of all random numbers.
    """

    participants: int = 15
    trials: int = 9
    amplitudes: tuple[float, ...] = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
    friction: tuple[float, float] = (0.3, 0.186)
    softness: tuple[float, ...] = (0.5, 0.7, 1.0, 1.4, 2.0)
    force: tuple[float, float, float, float] = (5.5, 0.45, 0.25, 0.12)
    force_range: tuple[float, float] = (1.0, 18.0)
    time_to_peak: tuple[float, float] = (1.47, 0.39)
    duration: tuple[float, float] = (1.0, 2.5)
    hold: tuple[float, float] = (0.15, 0.5)
    angle: tuple[float, float] = (9.9, 4.2)
    displacement: tuple[float, float] = (0.08, 0.10)
    real_area: tuple[float, float] = (23.7, 4.2)
    real_area_fall: float = 0.38
    real_area_noise: float = 0.4
    noise: float = 0.003
    felt_rate: float = 3.0
    cues: tuple[float, float] = (2.5, 3.6)
    frame_rate: float = 20.0
    mm_per_px: float = 0.0325
    view_px: int = 512
    seed: int = 0

    def friction_for(self, amplitude: Values) -> Values:
        """Return the friction coefficient at vibration amplitudes in µm."""
        low, high = self.friction
        return low * (high / low) ** np.sqrt(self._share(amplitude))

    def mean_forces(self) -> Values:
        """Return the mean peak forces (P,), N, of the participants, in turns of the lower and the upper half."""
        # Quantiles in place of random numbers: few people are a small sample.
        ranks = np.concatenate((np.arange(1, self.participants, 2), np.arange(0, self.participants, 2)))
        mean, spread = self.force[:2]
        return mean * np.exp(spread * ndtri((ranks + 0.5) / self.participants) - spread**2 / 2)

    def softness_of_people(self) -> Values:
        """Return the softness (P,) of the skin of the participants."""
        off = np.abs(np.log(np.outer(self.mean_forces(), self.softness) / self.force[0]))
        return np.take(self.softness, off.argmin(1))

    def _share(self, amplitude: Values) -> Values:
        return np.asarray(amplitude) / max(max(self.amplitudes), 1e-9)


@dataclass(frozen=True)
class Presses:
    """Parameters of N presses of a simulated study, one array of length N each, in which the reference press of a trial
    is directly followed by its comparison press.
    """

    participant: NDArray[np.int64]
    amplitude: Values  # µm, vibration amplitude
    softness: Values
    friction: Values
    force: Values  # N, peak normal force
    time_to_peak: Values  # s, time to the peak
    duration: Values  # s, time from first contact to the last frame
    angle: Values  # rad, angle of the force from the normal
    shift: Values  # (N, 2) mm, shift of the skin as a whole
    divergence: Values  # median over the apparent contact at the peak, since each point's onset
    gross_contact_area: Values  # mm², at the peak
    real_contact_area: Values  # mm², at the peak
    seed: NDArray[np.int64]  # seed of the camera

    def pairs(self) -> "tuple[Presses, Presses]":
        """Return the reference presses and the comparison presses, in the same order."""
        columns = vars(self).values()
        return Presses(*(column[::2] for column in columns)), Presses(*(column[1::2] for column in columns))


def draw_presses(design: Design) -> Presses:
    """Sample at random the parameters of all presses of a study: two presses per trial.

    Trials are ordered by participant, then by condition.
    """
    draw = np.random.default_rng(design.seed)
    amplitudes = np.repeat(design.amplitudes, design.trials)
    per_person = np.stack((np.zeros_like(amplitudes), amplitudes), -1).ravel()
    amplitude = np.tile(per_person, design.participants)
    participant = np.repeat(np.arange(design.participants), per_person.size)
    count = amplitude.size
    softness = design.softness_of_people()[participant]
    force, time = _draw_kinematics(design, draw, participant)
    hold = draw.uniform(*design.hold, count)
    friction = design.friction_for(amplitude)
    still, vibrating = design.angle
    angle = np.radians(still + (vibrating - still) * design._share(amplitude)) * draw.gamma(4.0, 0.25, count)
    length = np.minimum(_lognormal(draw, *design.displacement, count), 0.5)
    direction = draw.uniform(0, 2 * math.pi, count)
    divergence, area = _peak_values(design, softness, amplitude, force)
    # The ratio of real to apparent contact area falls with the amplitude, and varies between participants and presses.
    mean, deviation = design.real_area
    fall = 1 - design.real_area_fall * design._share(amplitude)
    person = _lognormal(draw, 1.0, deviation / mean, design.participants)[participant]
    ratio = mean / area.mean() / fall.mean() * fall * person * _lognormal(draw, 1.0, design.real_area_noise, count)
    return Presses(
        participant=participant,
        amplitude=amplitude,
        softness=softness,
        friction=friction,
        force=force,
        time_to_peak=time,
        duration=np.clip(time + hold, *design.duration),
        angle=np.minimum(angle, np.arctan(friction)),  # with a larger angle the finger would slide
        shift=np.stack((length * np.cos(direction), length * np.sin(direction)), -1),
        divergence=divergence,
        gross_contact_area=area,
        real_contact_area=area * np.clip(ratio, *_SHARES),
        seed=draw.integers(1 << 30, size=count),
    )


def answer_table(design: Design, reference: Presses, comparison: Presses) -> NDArray[np.bool_]:
    """Return the answers (T,) of a simulated observer in T trials, given the two presses of each: True if the
    comparison press felt more slippery.

    More divergence is felt as more slippery, the better the faster the press; a smaller angle and a larger displacement
    are felt so a little.
    """
    seen = -np.expm1(-comparison.force / comparison.time_to_peak / design.felt_rate)
    angle, displacement = design.cues
    evidence = seen * (comparison.divergence - reference.divergence) / design.noise
    evidence += angle * (reference.angle - comparison.angle)
    evidence += displacement * (np.hypot(*comparison.shift.T) - np.hypot(*reference.shift.T))
    return evidence + np.random.default_rng((design.seed, 1)).standard_normal(evidence.size) > 0


def make_recording(design: Design, presses: Presses, number: int) -> ChainPress:
    """Return press `number` of a study as a synthetic recording."""
    press = {name: values[number] for name, values in vars(presses).items()}
    side, frames_before, contact_time = design.view_px, 2, 0.02
    return ChainPress(
        friction=float(press["friction"]),
        parameters=_SKIN,
        softness=float(press["softness"]),
        force=float(press["force"]),
        steady=True,
        path_force=design.force_range[1],
        elements=_ELEMENTS,
        frame_shape=(side, 2 * side),
        mm_per_px=design.mm_per_px,
        finger=(0.49 * side * design.mm_per_px,) * 2,
        n_frames=frames_before + 1 + math.ceil((contact_time + press["duration"]) * design.frame_rate),
        frame_rate=design.frame_rate,
        frames_before_trigger=frames_before,
        contact_time=contact_time,
        rise_time=float(press["time_to_peak"]),
        relaxation=0.05,
        drag=math.tan(press["angle"]),
        shift=(float(press["shift"][0]), float(press["shift"][1])),
        contact_fraction=float(press["real_contact_area"] / press["gross_contact_area"]),
        camera=Camera(seed=int(press["seed"])),
    )


@lru_cache(maxsize=16)
def simulate_skin(friction: tuple[float, ...], softness: float, most: float) -> tuple[Values, PressedChain]:
    """Simulate the presses of a design's skin at K coefficients of friction to a force of `most` N, as a steady
    `ChainPress` does with a path to this force; return the normal forces (T,), N, and the states (T, K, ...) of the
    chains.
    """
    force = torch.from_numpy(most * force_share(np.linspace(0, 1, _TIMES)))
    time = force / PATH_N_S
    skin, coefficients = PARAMETERS[_SKIN].softer(softness), torch.tensor(friction, dtype=torch.float64)
    chain = follow(
        coefficients, time, force[:, None], parameters=skin, elements=_FEW_ELEMENTS, tolerance_m=_TOLERANCE_M
    )
    return force.numpy(), chain


def _draw_kinematics(
    design: Design, draw: np.random.Generator, participant: NDArray[np.int64]
) -> tuple[Values, Values]:
    """Sample at random the peak forces (N) and times to peak (s) of presses, two in a pair."""
    of_pair, of_press = design.force[2:] * np.sqrt((1.0, 0.5))
    middle = np.log(design.mean_forces()) - (of_pair**2 + of_press**2) / 2
    force, time = np.empty((2, participant.size // 2, 2))
    left = np.arange(len(force))
    while left.size:
        alike = np.exp(of_press * draw.standard_normal((2, left.size, 2)))
        shared = middle[participant[::2][left]] + of_pair * draw.standard_normal(left.size)
        force[left] = np.exp(shared)[:, None] * alike[0]
        time[left] = draw.normal(*design.time_to_peak, (left.size, 1)) * alike[1]
        (low, high), longest = design.force_range, design.duration[1] - design.hold[0]
        out = (force[left] < low) | (force[left] > high) | (time[left] < 0.4) | (time[left] > longest)
        left = left[out.any(1)]
    return force.ravel(), time.ravel()


def _lognormal(draw: np.random.Generator, mean: float, deviation: float, count: int) -> Values:
    square = math.log(1 + (deviation / mean) ** 2)
    return draw.lognormal(math.log(mean) - square / 2, math.sqrt(square), count)


def _peak_values(design: Design, softness: Values, amplitude: Values, force: Values) -> tuple[Values, Values]:
    """Return median divergence over the contact and apparent contact area (mm²) of N presses at their peak force, from
    softness, vibration amplitude (µm) and peak force (N), each (N,), by interpolation.
    """
    divergence, area = np.empty((2, force.size))
    frictions = design.friction_for(np.unique(amplitude))
    for level in np.unique(softness).tolist():
        forces, chain = simulate_skin(tuple(frictions), level, design.force_range[1])
        skin = since_onset(chain)
        for k, friction in enumerate(frictions):
            group = (design.friction_for(amplitude) == friction) & (softness == level)
            for values, table in ((divergence, skin.area_median), (area, 1e6 * skin.contact_area)):
                values[group] = np.interp(force[group], forces, table[:, k].nan_to_num(0.0).numpy())
    return divergence, area
