"""Simulated trials of tangential loading with known friction, as measured by a camera and a force sensor."""

from dataclasses import dataclass

import numpy as np

from fingerflow.engines.engine import Array
from fingerflow.models.partial_slip.evolution import critical_load_ratio, critical_stuck_area, stuck_area


@dataclass(frozen=True)
class SimulatedTrial:
    """Measured `time` (s), `load_ratio` T/N and `stuck_area` d^2 of each frame, and the true parameters of the trial.

    `critical_stuck_area` is the d^2 at which the area collapses, 0 if it fades.
    """

    time: Array
    load_ratio: Array
    stuck_area: Array
    mu_s: float
    mu_k: float
    critical_stuck_area: float
    collapse_ms: float


def simulate_trial(
    mu_s: float,
    mu_k: float,
    seed: int,
    frame_rate: float = 60.0,
    loading_s: float = 3.0,
    collapse_ms: float = 200.0,
    area_noise: float = 0.01,
    load_noise: float = 0.005,
    oscillation: float = 0.01,
    reached: float = 1.0,
    last: float | None = None,
) -> SimulatedTrial:
    """Simulate a slow ramp of T/N, the stuck area by equation 5, its collapse at constant T/N, and 1 s of full slip.

    Args:
        mu_s, mu_k: coefficients of static and kinetic friction.
        seed: of the noise and of the phase of the oscillation.
        frame_rate: frames/s.
        loading_s: s from no load to the critical load.
        collapse_ms: ms from the critical stuck area to none, if mu_k < mu_s; 130 to 310 in the paper.
        area_noise, load_noise: standard deviations of d^2 and, relative to the critical load, of T/N.
        oscillation: relative amplitude of a 3 Hz oscillation of T/N. The stuck area follows the largest T/N so far.
        reached: share of the critical load at which loading stops.
        last: stuck area to which the area falls in a straight line, and at which it collapses; None for the curve of
            the model.
    """
    noise = np.random.default_rng(seed)
    largest = float(critical_load_ratio(mu_s, mu_k))
    critical = float(critical_stuck_area(mu_s, mu_k).nan_to_num(0.0))
    time = np.arange(0, loading_s + 1 + collapse_ms / 1000, 1 / frame_rate)
    swing = 1 + oscillation * np.sin(2 * np.pi * (3 * time + noise.random()))
    load = largest * np.minimum(time / loading_s, reached) * swing
    highest = np.maximum.accumulate(load)
    area = stuck_area(highest, mu_s, mu_k).numpy()
    if last is not None:
        critical, area = last, 1 - (1 - last) * highest / largest
    lost = highest >= largest
    if lost.any():
        since = time - time[lost][0]
        collapse = collapse_ms / 1000 if critical > 0 else 1e-9
        area = np.where(lost, critical * np.clip(1 - since / collapse, 0, 1), area)
        load = np.where(lost, largest * swing, load)
    return SimulatedTrial(
        time=time,
        load_ratio=load + load_noise * largest * noise.standard_normal(time.size),
        stuck_area=np.clip(area + area_noise * noise.standard_normal(time.size), 0, 1),
        mu_s=mu_s,
        mu_k=mu_k,
        critical_stuck_area=critical,
        collapse_ms=collapse_ms,
    )
