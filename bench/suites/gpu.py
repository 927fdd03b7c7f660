"""Run time of the graphs on a GPU: eager, captured and compiled, for one frame or for frames of several recordings.

`contact` is `ContactGraph` on frames of a press in full contact, `key` is `KeyGraph` on 700 points of skin, `tracking`
is `TrackGraph` on its templates and skin moved by 0.3 px, `outliers` and `deformation` are `AgreementGraph` and
`DeformationGraph` on what it found, `fields` is `FieldsGraph` on the displacements of 700 points with deviations and
medians; views of 512 x 640 px (a quarter of the side and 100 points with --quick). Frames stay on the device: a
camera's cable and the disk are not in it. `captured` is the step in a CUDA graph, which the host starts by one call;
`compiled` is `torch.compile` with fixed shapes, before it is timed. ms is a frame's share of a call, and time_to_peer
is over the same frames on this machine's processor, by the same graphs and with the compiled kernels where they were
built. `deviation` is the largest from the processor's result: of an area in px, of samples, of a position in px, of a
divergence; NaN in one and not in the other counts as infinite.

`launches` are the operations that an eager call gives the accelerator, `MB` and `MFLOP` what they move and compute for
a frame, by `bench/launches.py`; for a step that makes the host wait, `waits` says for what, and it cannot be captured.
The columns of named GPUs are frames a second that these counts predict, eager and captured: an upper limit, from the
maker's figures (`bench/devices.py`). `launches_captured` are those of the host where each step is captured: a copy of
its inputs, the graph, a copy of its results. The numbers of the host that a step takes, and its results, are one copy
each besides.

The rows `fused` are those with the kernels of Triton, whose bytes and operations are those of formulas
(`bench/fused_work.py`); the one that follows the points has eight frames in a launch, of which one is counted. There
`points` is `PointsGraph`: tracking, outliers and deformation as one step, as a GPU with Triton takes them. `frame` is
the sum of the steps that each frame of a recording takes: `contact`, `tracking`, `outliers`, `deformation` and
`fields`, and with Triton `contact`, `points` and `fields`. On a GPU the counts are those of the `form` that runs there;
without CUDA nothing is measured, and there are rows of both forms.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.utils._pytree import tree_leaves, tree_map

from bench.devices import DEVICES, predicted_seconds
from bench.launches import HostWait, Launches, count_launches
from bench.rows import Row
from bench.skin import clean_picture, photograph
from bench.timing import time_in_turns
from fingerflow.engines.capture import Captured
from fingerflow.engines.memory import TOGETHER
from fingerflow.engines.points_graph import PointsGraph, TrackedPoints
from fingerflow.graphs import (
    AgreementGraph,
    ContactGraph,
    DeformationGraph,
    FieldsGraph,
    GrossEllipse,
    KeyGraph,
    LightGraph,
    TrackGraph,
)
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.tracking_limits import WARP_GAUGE_PX
from fingerflow.ops.tracking.outliers import Neighbours, find_neighbours
from fingerflow.ops.tracking.templates import Found, Templates
from fingerflow.synthetic import Press

PEER = "processor"
SHAPE, QUICK_SHAPE = (512, 640), (128, 160)
BATCHES = (1, 8, TOGETHER // 2, TOGETHER)  # numbers of recordings; a study computes them in two halves

# Steps of a frame of a recording: of the portable form, and with kernels of Triton.
_STEPS = ("contact", "tracking", "outliers", "deformation", "fields")
_FUSED_STEPS = ("contact", "points", "fields")
_BEFORE = 3  # calls that are not timed: a module is captured in its third

Call = Callable[..., object]


WAYS: Mapping[str, Callable[[nn.Module], Call]] = {
    "eager": lambda graph: graph,
    "captured": Captured,
    "compiled": lambda graph: torch.compile(graph, dynamic=False),
}


class Work(NamedTuple):
    """A graph, what it is given for a batch of frames, and which of its results is compared; and the graph that
    computes the same on a processor, where that is another one.
    """

    graph: nn.Module
    inputs: tuple[Any, ...]
    result: Callable[..., Tensor]
    peer: nn.Module | None = None


class _StepByStep(nn.Module):
    """Module that computes what `PointsGraph` does, by the portable form of tracking."""

    def __init__(self, graph: PointsGraph) -> None:
        super().__init__()
        self.track, self.graph = TrackGraph(graph.forward_backward_limit), graph

    def forward(
        self,
        templates: Templates,
        views: Tensor,
        place: Tensor,
        speed: Tensor,
        lengths: Tensor,
        neighbours: Neighbours,
        start: Tensor,
        inverse_warp: Tensor,
    ) -> TrackedPoints:
        found: Found = self.track(templates, views, place + speed)
        deformed = self.graph.judge_and_correct(found, neighbours, start, templates.numbers, inverse_warp)
        return TrackedPoints(found, found.estimate, speed, deformed)


def run(quick: bool) -> list[Row]:
    """One row a work, way and number of recordings."""
    shape, points, batches = (QUICK_SHAPE, 100, (1, 4)) if quick else (SHAPE, 700, BATCHES)
    if not torch.cuda.is_available():
        return [row for batch in batches for row in _predicted_rows(_works(shape, points, batch), batch)]
    return rows_on(torch.device("cuda"), shape, points, batches, WAYS, rounds=2 if quick else 9)


def _predicted_rows(works: "Mapping[str, Work]", batch: int) -> list[Row]:
    """Return a row for each work, one for each that kernels of Triton compute otherwise, and the sums over a frame."""
    portable = {name: _launches(work) for name, work in works.items() if name != "points"}
    counted: dict[str, Launches | str] = dict(portable)
    steps = {name: launches for name, launches in portable.items() if isinstance(launches, Launches)}
    if len(steps) == len(portable):
        counted["frame"] = _joined([steps[name] for name in _STEPS])
        if find_spec("triton") is not None:
            fused = _fused_steps(works, steps)
            counted |= {f"{name}, fused": launches for name, launches in fused.items()}
            counted["frame, fused"] = _joined([(steps | fused)[name] for name in _FUSED_STEPS])
    return [
        {"work": name, "recordings": batch, **_counts(launches, batch), "measured": "none: no device here"}
        for name, launches in counted.items()
    ]


def _fused_steps(works: "Mapping[str, Work]", portable: Mapping[str, Launches]) -> dict[str, Launches]:
    """Return the launches of the works that kernels of Triton compute otherwise than the `portable` form."""
    from bench.fused_work import fused_kernels  # needs Triton

    fused = {name: count_launches(work.graph, work.inputs, fused_kernels) for name, work in works.items()}
    return {
        name: launches
        for name, launches in sorted(fused.items())
        if name not in portable or launches.calls < portable[name].calls
    }


def _joined(steps: Sequence[Launches]) -> Launches:
    """Return the launches of several steps, one after the other."""
    work = sum((one.work for one in steps), ())
    return Launches(len(work), None, work, max(one.peak for one in steps), sum(one.captured for one in steps))


def _launches(work: "Work") -> Launches | str:
    """Return the launches of a work, or for what the host waits."""
    try:
        return count_launches(work.graph, work.inputs)
    except HostWait as wait:
        return str(wait)


def _counts(launches: Launches | str, batch: int) -> dict[str, float | int | str | None]:
    """Return the columns of counts, and the frames a second that they predict for a call of `batch` frames."""
    if isinstance(launches, str):
        return {"launches": None, "waits": launches}
    return {
        "launches": launches.calls,
        "launches_captured": launches.captured,
        "waits": None,
        "MB": sum(one.bytes for one in launches.work) / batch / 1e6,
        "MFLOP": sum(one.flops for one in launches.work) / batch / 1e6,
        "peak_MB": launches.peak / batch / 1e6,
        **{
            f"{name} {way}": float(round(batch / predicted_seconds(launches.work, device, way == "captured")))
            for name, device in DEVICES.items()
            for way in ("eager", "captured")
        },
    }


@torch.inference_mode()
def rows_on(
    device: torch.device,
    shape: tuple[int, int],
    points: int,
    batches: Sequence[int],
    ways: Mapping[str, Callable[[nn.Module], Call]],
    rounds: int,
) -> list[Row]:
    """The rows of any device."""
    rows: list[Row] = []
    fused = kernels.fused_serves(torch.empty(0, device=device))
    for batch in batches:
        works = {name: work for name, work in _works(shape, points, batch).items() if fused or name != "points"}
        counted = {name: _launches(work) for name, work in works.items() if name != "points"}
        if fused:
            counted |= _fused_steps(works, {name: one for name, one in counted.items() if isinstance(one, Launches)})
        for name, work in works.items():
            calls: dict[str, Callable[[], object]] = {PEER: _call(work.peer or work.graph, work.inputs)}
            on_device = tree_map(lambda value: value.to(device) if isinstance(value, Tensor) else value, work.inputs)
            calls |= {
                way: _call(prepare(work.graph), on_device)
                for way, prepare in ways.items()
                if prepare is not Captured or isinstance(counted[name], Launches)
            }
            for call in (*calls.values(),) * _BEFORE:
                call()
            times = time_in_turns(calls, PEER, rounds)
            expected = work.result(calls[PEER]())
            for way, call in calls.items():
                rows.append(
                    {
                        "work": name,
                        "recordings": batch,
                        "way": way,
                        "form": "fused" if fused else "portable",
                        **_counts(counted[name], batch),
                        **times[way].of_each(batch).cells(),
                        "deviation": _deviation(work.result(call()).cpu(), expected),
                    }
                )
    return rows


def _call(graph: Call, inputs: tuple[Any, ...]) -> Callable[[], object]:
    def call() -> object:
        result = graph(*inputs)
        if any(one.is_cuda for one in tree_leaves(inputs) if isinstance(one, Tensor)):
            torch.cuda.synchronize()
        return result

    return call


def _deviation(found: Tensor, expected: Tensor) -> float:
    known = expected.isfinite()
    if not torch.equal(found.isfinite(), known):
        return float("inf")
    return (found - expected)[known].abs().max().item() if known.any() else 0.0


def _works(shape: tuple[int, int], points: int, batch: int) -> dict[str, Work]:
    generator = torch.Generator().manual_seed(0)
    previous, current = (
        torch.cat([photograph(clean_picture(shape, shift), 2, seed + 1000 * number) for number in range(batch)])
        for seed, shift in enumerate(((0.0, 0.0), (0.3, 0.2)))
    )
    room = torch.tensor((shape[1] - 37, shape[0] - 37), dtype=torch.float32)
    places = 18 + room * torch.rand(batch, points, 2, generator=generator)
    displacement = 0.03 * places.flip(-1) + 0.02 * torch.randn(places.shape, generator=generator)
    key = KeyGraph(21)
    covariance = (4e-4 * torch.eye(2)).expand(*places.shape[:2], 2, 2)
    templates = key(previous, places)
    found = TrackGraph()(templates, current, places)
    near = find_neighbours(places, WARP_GAUGE_PX)
    straight = torch.eye(2).expand_as(covariance).contiguous()
    middle = torch.tensor([[shape[1] / 2, shape[0] / 2]]).repeat(batch, 1)
    ellipse = GrossEllipse(middle, middle * 0.6, torch.zeros(batch))
    whole, frames = PointsGraph(21, 1.0), torch.ones(batch, dtype=torch.int32)
    return {
        "contact": Work(ContactGraph(), _contact_frames(shape, batch), lambda contact: contact.real_area_px),
        "key": Work(key, (previous, places), lambda templates: templates.samples),
        "tracking": Work(TrackGraph(), (templates, current, places), lambda found: found.points),
        "outliers": Work(
            AgreementGraph(),
            (near, places, found.points, found.variance.sqrt()),
            lambda outliers: outliers.off_neighbours.float(),
        ),
        "deformation": Work(
            DeformationGraph(21), (places, found, templates.numbers, straight), lambda deformed: deformed.found.points
        ),
        "points": Work(
            whole,
            (templates, current, places, torch.zeros_like(places), frames, near, places, straight),
            lambda tracked: tracked.deformed.found.points,
            _StepByStep(whole),
        ),
        "fields": Work(
            FieldsGraph(50.0), (places, displacement, covariance, ellipse), lambda fields: fields.divergence
        ),
    }


def _contact_frames(shape: tuple[int, int], batch: int) -> tuple[Tensor, ...]:
    """Frames, light, darkness and limits, as `ContactGraph` takes them."""
    rows, columns = shape
    large = min(rows / 512, columns / 640)
    press = Press(
        n_frames=batch + 1,
        frame_rate=1.0,
        frames_before_trigger=0,
        frame_shape=(rows, 2 * columns),
        finger=(7.6 * large, 6.4 * large),
        semi_axes=(5.5 * large, 4.5 * large),
    )
    view = press.views["contact"]
    frames = torch.stack([torch.from_numpy(view.crop(press.render(frame))) for frame in range(1, batch + 1)])[:, None]
    empty, dark = (
        torch.from_numpy(view.crop(picture)).float()[None, None] for picture in (press.empty(), press.dark())
    )
    light, black, _ = LightGraph()(empty, dark, torch.zeros(1))
    limit = 1 - ContactGraph().threshold(frames[:1], light, black)
    return frames, light, black, limit.expand(batch).clone()
