"""Time of a counted step on a named GPU: a prediction from its maker's figures, no measurement.

A call takes as long as the slowest of four: its bytes at the bandwidth, its operations at the peak rate of float32, the
bytes that it reads again from caches, and what starting it costs. A call of fewer programs than the GPU has
multiprocessors has their share of peak and caches only. Peaks are never reached, so that the prediction is the least
time that is possible, but for what caches keep from one call to the next and for what a compiler would fuse.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bench.launches import Work


class Device(NamedTuple):
    """Figures of a GPU.

    Attributes:
        bandwidth: of its memory, bytes/s.
        peak: float32 operations/s.
        eager, captured: s to start one call: from the host, and inside a graph.
        processors: number of multiprocessors.
        clock: of these, Hz.
    """

    bandwidth: float
    peak: float
    eager: float
    captured: float
    processors: int
    clock: float


# Bandwidth and peak: NVIDIA's data sheets of H100 SXM5 and Jetson AGX Orin 64 GB, and its white paper of the Ada
# architecture. Starting a call: 4 to 6 us by torch on a server, some 1.7 us as a node of a CUDA graph (600 nodes take
# about 1 ms); of the Jetson's slower cores three and two times as long. These four are assumed, and so is the rate of a
# multiprocessor's cache, half of the documented one.
_CACHE = 64  # bytes a clock
DEVICES: Mapping[str, Device] = {
    "H100": Device(3.35e12, 66.9e12, 5e-6, 1.7e-6, 132, 1.98e9),
    "RTX 4090": Device(1.008e12, 82.6e12, 5e-6, 1.7e-6, 128, 2.52e9),
    "Jetson AGX Orin": Device(204.8e9, 5.3e12, 15e-6, 3.4e-6, 16, 1.3e9),
}


def predicted_seconds(work: Sequence[Work], device: Device, captured: bool) -> float:
    """Predict the time, s, that the calls of a step take one after the other, eager or as nodes of one CUDA graph."""
    start = device.captured if captured else device.eager
    return sum(max(start, one.bytes / device.bandwidth, _on_processors(one, device)) for one in work)


def _on_processors(work: Work, device: Device) -> float:
    """Return the time, s, for the operations of a call and for what it reads from caches, on the multiprocessors that
    its programs fill.
    """
    programs = work.programs or device.processors
    share = programs / (device.processors * math.ceil(programs / device.processors))
    return max(work.flops / device.peak, work.cached / (_CACHE * device.clock * device.processors)) / share


def fused_tracking(points: int, window: int, recordings: int, frames: int) -> list[Work]:
    """Return the work of `kernels.tensors.fused_tracking` on one of the frames that recordings have in a launch.

    A point reads its template once, and of each frame a patch; its tile of a power of two is multiplied twice.
    """
    samples, side = window**2, 2 ** math.ceil(math.log2(window + 6))
    template, of_frame = 4 * (3 * samples + 32), (window + 6) ** 2 + 4 * (2 + 1 + 4 + 2) + 1
    flops = 2 * 2 * side**3 + 80 * side**2  # products; weights and sums
    every = points * recordings
    return [Work(every * (template // frames + of_frame), every * flops)]
