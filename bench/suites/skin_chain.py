"""Run time and error of the skin-chain model: the first 50 ms of a press at 3 N and a friction coefficient of 0.6.

The chain has 501 elements and the lab's parameters (41 elements and 5 ms with --quick).

`error_um` is the largest error of a place at the end against steps of a tolerance 1,000 times smaller. Ways: TR-BDF2 of
`models.skin_chain`, compiled and portable, at several tolerances in m; one press and 100 values of friction, to rest;
and SciPy's explicit Runge-Kutta of order 5 with step control on equations 5 and 7, in place of the published one of
order 4 with a fixed step. `time_to_peer` is the time over that of one press to rest. What runs once is CPU time of
its process.
"""

import time
from collections.abc import Callable
from functools import partial
from unittest.mock import patch

import numpy as np
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

from bench.rows import Row
from bench.timing import time_in_turns
from fingerflow.kernels import tensors as kernels
from fingerflow.models.skin_chain import follow, press
from fingerflow.models.skin_forces import Array, Chain, elastic_forces
from fingerflow.models.skin_motion import Chains
from fingerflow.models.skin_parameters import PARAMETERS

FRICTION, LOAD_N = 0.6, 3.0
TOLERANCES = (5e-7, 5e-8, 5e-9)
PEER = "to rest, one press"


def run(quick: bool) -> list[Row]:
    """Return a row per way."""
    elements, duration = (41, 0.005) if quick else (501, 0.05)

    def moved(tolerance: float) -> Tensor:
        times = torch.tensor([0.0, duration], dtype=torch.float64)
        return follow(FRICTION, times, LOAD_N, elements=elements, tolerance_m=tolerance).position[-1]

    exact = moved(TOLERANCES[1] / 1000)
    compiled = "compiled" if kernels.serve() else "portable"
    ways: dict[str, Callable[[], object]] = {f"{compiled}, {limit:g}": partial(moved, limit) for limit in TOLERANCES}
    ways[PEER] = partial(press, FRICTION, load_n=LOAD_N, elements=elements)
    frictions = torch.linspace(0, 1.2, 100, dtype=torch.float64)
    ways["to rest, 100 frictions"] = partial(press, frictions, load_n=LOAD_N, elements=elements)
    times = time_in_turns(ways, PEER, rounds=2 if quick else 5)
    rows: list[Row] = []
    for name in ways:
        error = None
        if not name.startswith("to rest"):
            error = 1e6 * (moved(float(name.split(", ")[1])) - exact).abs().max().item()
        rows.append({"way": name, **times[name].cells(), "error_um": error})
    peer_ms = times[PEER].median_ms
    for name, once in (
        (f"portable, {TOLERANCES[1]:g}", partial(_portable, partial(moved, TOLERANCES[1]))),
        ("Runge-Kutta, SciPy", partial(_explicit, elements, duration)),
    ):
        start = time.process_time()
        place = once()
        ms = 1e3 * (time.process_time() - start)
        error = 1e6 * (place - exact).abs().max().item()
        rows.append({"way": name, "ms": ms, "time_to_peer": ms / peer_ms, "error_um": error})
    return rows


def _portable(call: Callable[[], Tensor]) -> Tensor:
    with patch.object(kernels, "serve", lambda *tensors: False):
        return call()


def _explicit(elements: int, duration: float) -> Tensor:
    chain = Chains.of(PARAMETERS["lab"], elements, torch.Size(())).single(0)
    place, _ = runge_kutta(chain, np.full(elements, FRICTION), np.array([0.0, -LOAD_N]), duration)
    return torch.from_numpy(place)


def runge_kutta(chain: Chain, mu: Array, load: Array, duration: float) -> tuple[Array, Array]:
    """Return positions (N, 2) in m and friction (N,) in N of a chain after ``duration`` s under a load (2,) in N.

    Equation 5 has the forces of `skin_forces`; equation 7 is Dahl's friction without its stray factor.
    """
    count = len(mu)

    def unpacked(state: Array) -> tuple[Array, Array, Array]:
        nodes = state[: 2 * count + 2].reshape(-1, 2) + np.vstack((chain.reference, (0.0, 0.0)))
        limit = mu * chain.contact * np.maximum(-nodes[:-1, 1], 0)
        return nodes, limit, np.clip(state[2 * count + 2 :], -limit, limit)

    def rates(time: float, state: Array) -> Array:
        nodes, limit, held = unpacked(state)
        forces = elastic_forces(chain, nodes)
        forces[:-1, 0] -= held  # against the motion
        forces[-1] += load
        speed = forces / chain.dampers
        rubs = limit > 0
        left = 1 - np.sign(speed[:-1, 0]) * held / np.where(rubs, limit, 1.0)
        rate = chain.friction_stiffness * np.abs(left) ** chain.exponent * np.sign(left) * speed[:-1, 0]
        return np.concatenate((speed.ravel(), np.where(rubs, rate, 0.0)))

    # Positions to 0.1 nm and forces to 1e-7 N: both are small where skin hardly moves.
    absolute = np.concatenate((np.full(2 * count + 2, 1e-10), np.full(count, 1e-7)))
    end = solve_ivp(rates, (0.0, duration), np.zeros(3 * count + 2), rtol=1e-6, atol=absolute).y[:, -1]
    nodes, _, held = unpacked(end)
    return nodes[:-1], held
