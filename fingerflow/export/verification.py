"""Exported graphs beside torch: ONNX Runtime on the processor, the recipe's precision and float64."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.errors import FingerflowError
from fingerflow.export.build import UNITS, build
from fingerflow.export.portable import Portable
from fingerflow.export.recipe import Recipe
from fingerflow.export.trial import cases, completed, feed
from fingerflow.kernels.tracking_limits import Number


class Difference(NamedTuple):
    """How far an output of a graph was from torch at most, over all trial cases; NaN where both are NaN is no
    difference.

    `to_torch` and `to_float64` are in the unit for px and rad, else shares of the largest number, or of 1 if that is
    more; `flips` counts numbers that are NaN in one only, and `share` the share of these, or of differing integers,
    against float64.
    """

    graph: str
    output: str
    unit: str
    to_torch: float
    to_float64: float
    flips: int
    share: float


@dataclass(frozen=True)
class GraphTolerance:
    """Largest differences to torch in the same precision and to float64; what one graph passes on is not its error."""

    to_torch: float
    to_float64: float


# Points: a position of 640 px has steps of 6e-5 px in float32; 1e-3 px is what the project promises. Fields: rounding
# of a position over a gauge length of tens of px. All but px and rad is relative to the largest number of the output:
# points that jump by tens of px have strains far beyond 1.
_TOLERANCES = {
    "points": GraphTolerance(1e-3, 1e-3),
    # Of matches that are none, whose backward check and step are nearly singular; the limit of both is 1 px.
    **dict.fromkeys(("error", "estimate"), GraphTolerance(2e-2, 2e-2)),
    **dict.fromkeys(
        ("divergence", "curl", "strain", "shear", "median", "gradient", "warp"), GraphTolerance(2e-4, 1e-3)
    ),
    # A cell at the border of the region may be told either way in float64.
    **dict.fromkeys(("center", "semi_axes"), GraphTolerance(1e-3, 0.1)),
    "angle": GraphTolerance(1e-4, 2e-2),  # what turns an axis that is 5 px longer than the other by that 0.1 px
    **dict.fromkeys(("threshold", "covariance"), GraphTolerance(1e-4, 1e-3)),  # of the latter, as deviations in px
}
_RELATIVE = GraphTolerance(1e-4, 1e-3)
_MOST_FLIPS = 1e-2  # share of decisions (real contact, tracked, returns) that rounding may turn against float64


def verify(recipe: Recipe, folder: Path) -> list[Difference]:
    """Runs the graphs in a folder beside torch, with one and with two recordings where the batch is open.

    Raises:
        FingerflowError: an output differs by more than its tolerance; all that do are named.
    """
    import onnxruntime

    batches = (1, 2) if recipe.views.batch == "dynamic" else (recipe.views.batch,)
    graphs, exact = build(recipe), build(recipe, torch.float64)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    sessions = {
        name: onnxruntime.InferenceSession(folder / f"{name}.onnx", options, providers=["CPUExecutionProvider"])
        for name in graphs
    }
    worst: dict[tuple[str, str], Difference] = {}
    for batch in batches:
        for case in cases(recipe, batch):
            known = completed(recipe, case)  # each graph gets the same inputs in all three: errors do not pass on
            for name in sessions:
                graph = graphs[name]
                tensors = feed(name, graph, known)
                with torch.inference_mode(), Portable():
                    reference = graph.module(*tensors)
                    double = exact[name].module(*(_double(one) for one in tensors))
                arrays = {one: tensor.numpy() for one, tensor in zip(graph.inputs, tensors, strict=True)}
                inputs = {one.name for one in sessions[name].get_inputs()}
                results = sessions[name].run(list(graph.outputs), {k: v for k, v in arrays.items() if k in inputs})
                for output, ours, near, far in zip(graph.outputs, results, reference, double, strict=True):
                    row = _difference(name, output, ours, near.numpy(), far.numpy())
                    key = (name, output)
                    worst[key] = row if key not in worst else _worse(worst[key], row)
    rows = list(worst.values())
    wrong = [row for row in rows if not _tolerable(row)]
    if wrong:
        raise FingerflowError(
            "ONNX Runtime and torch differ by more than rounding explains; nothing was written:\n" + as_text(wrong)
        )
    return rows


def as_text(rows: list[Difference]) -> str:
    """A table of the largest differences."""
    head = f"{'graph':<16}{'output':<20}{'unit':<9}{'to torch':>11}{'to float64':>12}{'NaN flips':>11}{'int share':>11}"
    lines = [
        f"{row.graph:<16}{row.output:<20}{row.unit[:8]:<9}{row.to_torch:>11.2g}{row.to_float64:>12.2g}{row.flips:>11}"
        f"{row.share:>11.2g}"
        for row in rows
    ]
    return "\n".join((head, *lines))


def _double(tensor: Tensor) -> Tensor:
    return tensor.double() if tensor.is_floating_point() else tensor


def _difference(graph: str, output: str, ours: NDArray[Any], near: NDArray[Any], far: NDArray[Any]) -> Difference:
    unit = UNITS[output]
    if output == "status":
        # Whether a point is tracked. Why it is not may turn on the last digit: far from any root, steps are chaotic.
        ours, near, far = (values != 0 for values in (ours, near, far))
    if output == "covariance":
        ours, near, far = (np.sqrt(values[..., (0, 1), (0, 1)]) for values in (ours, near, far))
        unit = "px"
    if output == "template_numbers":
        # Without texture they are quotients of rounding errors, and nothing is found with them.
        textured = near[..., Number.TEXTURED] > 0
        ours, near, far = (values[textured] for values in (ours, near, far))
    if graph == "detect" and output == "points":
        # Corners of nearly equal strength change places, and the last of them their turn.
        return Difference(graph, output, unit, _absent(near, ours), _absent(far, ours), 0, 0.0)
    if not np.issubdtype(near.dtype, np.floating):
        share = float(np.mean(ours != far)) if ours.size else 0.0
        return Difference(graph, output, unit, float(np.max(ours != near, initial=0)), 0.0, 0, share)
    scale = 1.0 if unit in ("px", "rad") else max(1.0, float(np.nanmax(np.abs(far), initial=0)))
    flips = int(np.sum(np.isfinite(ours) != np.isfinite(near)))
    share = float(np.mean(np.isfinite(ours) != np.isfinite(far))) if ours.size else 0.0
    return Difference(graph, output, unit, _largest(ours, near) / scale, _largest(ours, far) / scale, flips, share)


def _absent(expected: NDArray[Any], found: NDArray[Any]) -> float:
    """Share of the expected points (B, N, 2) that were not found, less the hundredth that may be."""
    known = [{tuple(point) for point in points[np.isfinite(points).all(-1)].tolist()} for points in (expected, found)]
    absent = len(known[0] - known[1]) / max(1, len(known[0]))
    return max(0.0, absent - _MOST_FLIPS)


def _largest(ours: NDArray[Any], other: NDArray[Any]) -> float:
    both = np.isfinite(ours) & np.isfinite(other)
    return float(np.max(np.abs(ours[both].astype(np.float64) - other[both]), initial=0.0))


def _worse(one: Difference, other: Difference) -> Difference:
    return Difference(
        *one[:3],
        max(one.to_torch, other.to_torch),
        max(one.to_float64, other.to_float64),
        max(one.flips, other.flips),
        max(one.share, other.share),
    )


def _tolerable(row: Difference) -> bool:
    tolerance = _TOLERANCES.get(row.output, _RELATIVE)
    near, far = row.to_torch <= tolerance.to_torch, row.to_float64 <= tolerance.to_float64
    return near and far and row.flips == 0 and row.share <= _MOST_FLIPS
