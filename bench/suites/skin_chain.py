"""The skin chain: 50 ms of a press of 3 N at mu = 0.6, 501 elements, the lab's parameters (41 and 5 ms with --quick).

`error_um` is the largest error of a place at the end against steps of a tolerance 1,000 times smaller. Ways: TR-BDF2 of
`models.skin_chain`, compiled and portable, at several tolerances in m; the published algorithm, fourth-order
Runge-Kutta of `models.skin_explicit`, in NumPy with all elements at once, at 0.8 of its largest stable step, run once;
one press and 100 values of friction together, to rest; and one press to rest with the gradient of its divergence (in
friction, and with it all stiffnesses). `time_to_peer` is the time over that of one press to rest. What runs once is CPU
time of its process.

The published script runs element by element in MATLAB, this transcription is faster than that.
"""

import time
from collections.abc import Callable
from functools import partial
from unittest.mock import patch

import numpy as np
import torch
from torch import Tensor

from bench.rows import Row
from bench.timing import time_in_turns
from fingerflow.kernels import tensors as kernels
from fingerflow.models.skin_chain import follow, press
from fingerflow.models.skin_explicit import largest_step, march
from fingerflow.models.skin_implicit import Load, State
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
    ways["to rest, with gradient"] = partial(_gradient, elements)
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
        ("published Runge-Kutta, NumPy", partial(_published, elements, duration)),
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


def _published(elements: int, duration: float) -> Tensor:
    chain = Chains.of(PARAMETERS["lab"], elements, torch.Size(())).single(0)
    state = State(chain.reference.copy(), np.zeros(2), np.zeros(elements))
    force = np.array([0.0, -LOAD_N])
    load = Load(force, force, np.zeros(2, dtype=bool))
    march(chain, state, np.full(elements, FRICTION), load, duration, 0.8 * largest_step(chain))
    return torch.from_numpy(state.place)


def _gradient(elements: int) -> tuple[Tensor, ...]:
    friction = torch.tensor(FRICTION, dtype=torch.float64, requires_grad=True)
    return torch.autograd.grad(press(friction, load_n=LOAD_N, elements=elements).divergence, friction)
