"""Verification of exported graphs: ONNX Runtime on the CPU against torch in the recipe's precision and in float64."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.export.build import UNITS, build
from fingerflow.export.recipe import Recipe
from fingerflow.export.verification_frames import cases, complete_inputs, inputs_of
from fingerflow.kernels.tracking_limits import Number


class Difference(NamedTuple):
    """Largest difference between ONNX Runtime and torch in one output of a graph, over all test cases.

    A value that is NaN in both is no difference. `to_torch` and `to_float64` are in px or rad if that is the unit, else
    relative to the largest value, or to 1 if that is larger. `flips` counts values that are NaN in only one of ONNX
    Runtime and torch. `share` is the share of such values, or of differing integers, relative to float64.
    """

    graph: str
    output: str
    unit: str
    to_torch: float
    to_float64: float
    flips: int
    share: float


# Largest tolerated differences of ONNX results to torch in the same precision, and to torch in float64; each graph gets
# the same inputs. Points: a position of 640 px has a spacing of 6e-5 px in float32; the project guarantees 1e-3 px.
# Fields: rounding of a position over a gauge length of tens of px. Except for px and rad, differences are relative to
# the largest value of the output: points that jump by tens of px have strains far beyond 1.
_TOLERANCES = {
    "points": (1e-3, 1e-3),
    # False matches have a nearly singular backward check and step; accepted points have at most 1 px in both.
    **dict.fromkeys(("error", "estimate"), (2e-2, 2e-2)),
    **dict.fromkeys(("divergence", "curl", "strain", "shear", "median", "gradient", "warp"), (2e-4, 1e-3)),
    # A cell at the border of the region may be classified differently in float64.
    **dict.fromkeys(("center", "semi_axes"), (1e-3, 0.1)),
    "angle": (1e-4, 2e-2),  # 0.1 px turns an axis that is 5 px longer than the other by this angle
    **dict.fromkeys(("threshold", "covariance"), (1e-4, 1e-3)),  # covariance as standard deviations in px
    # 1 - r^2 is a sum of terms up to the square of half an image in radii, 2,000: their rounding in float32 is 1e-4.
    # It moves a fitted plane by 1e-4 of the residuals.
    **dict.fromkeys(("support_weights", "inner_weights"), (1e-3, 1e-3)),
}
_RELATIVE = (1e-4, 1e-3)
_MOST_FLIPS = 1e-2  # largest share of decisions (real contact, tracked, returns) that rounding may change


def verify(recipe: Recipe, folder: Path) -> list[Difference]:
    """Verify the exported graphs of a recipe in a folder: compare the outputs of ONNX Runtime with those of torch on
    all test cases.

    Cases have the batch size of the recipe; a dynamic batch is verified with one recording and with two.

    Returns:
        The largest differences, one row an output.

    Raises:
        FingerflowError: an output differs by more than its tolerance; the message lists all that do.
    """
    import onnxruntime

    batches = (1, 2) if recipe.views.batch == "dynamic" else (recipe.views.batch,)
    graphs, exact = build(recipe), build(recipe, torch.float64)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    sessions = {
        name: onnxruntime.InferenceSession(folder / f"{name}.onnx", options, providers=["CPUExecutionProvider"])
        for name in recipe.export.graphs
    }
    worst: dict[tuple[str, str], Difference] = {}
    for batch in batches:
        for case in cases(recipe, batch):
            known = complete_inputs(
                recipe, case
            )  # each graph gets the same inputs in all three versions, so that errors do not propagate between graphs
            for name in sessions:
                graph = graphs[name]
                given = inputs_of(name, graph, known)
                reference = graph.run(given)
                doubles = {one: part.double() if part.is_floating_point() else part for one, part in given.items()}
                double = exact[name].run(doubles)
                arrays = {one.name: given[one.name].numpy() for one in sessions[name].get_inputs()}
                for output, ours in zip(graph.outputs, sessions[name].run(graph.outputs, arrays), strict=True):
                    row = _difference(name, output, ours, reference[output].numpy(), double[output].numpy())
                    before = worst.setdefault((name, output), row)
                    larger = {one: max(getattr(before, one), getattr(row, one)) for one in Difference._fields[3:]}
                    worst[name, output] = before._replace(**larger)
    rows = list(worst.values())
    wrong = [row for row in rows if not _tolerable(row)]
    if wrong:
        raise FingerflowError(
            "ONNX Runtime and torch differ by more than rounding explains; nothing was written:\n" + as_text(wrong)
        )
    return rows


def as_text(rows: list[Difference]) -> str:
    """Return the largest differences between ONNX Runtime and torch as a text table, one row for each graph output."""
    head = f"{'graph':<16}{'output':<20}{'unit':<9}{'to torch':>11}{'to float64':>12}{'NaN flips':>11}{'int share':>11}"
    lines = [
        f"{row.graph:<16}{row.output:<20}{row.unit[:8]:<9}{row.to_torch:>11.2g}{row.to_float64:>12.2g}{row.flips:>11}"
        f"{row.share:>11.2g}"
        for row in rows
    ]
    return "\n".join((head, *lines))


def _difference(graph: str, output: str, ours: NDArray[Any], near: NDArray[Any], far: NDArray[Any]) -> Difference:
    unit = UNITS[output]
    if output == "status":
        # Compare only whether a point is tracked: far from a solution the reason for its loss depends on rounding.
        ours, near, far = (values != 0 for values in (ours, near, far))
    if output == "covariance":
        ours, near, far = (np.sqrt(values[..., (0, 1), (0, 1)]) for values in (ours, near, far))
        unit = "px"
    if output == "template_numbers":
        # Without texture, template statistics are quotients of rounding errors, and such points are not tracked.
        textured = near[..., Number.TEXTURED] > 0
        ours, near, far = (values[textured] for values in (ours, near, far))
    if graph == "detect" and output == "points":
        # Corners of nearly equal strength may swap their order, and the weakest selected ones may differ.
        return Difference(graph, output, unit, _missing_share(near, ours), _missing_share(far, ours), 0, 0.0)
    if not np.issubdtype(near.dtype, np.floating):
        share = float(np.mean(ours != far)) if ours.size else 0.0
        return Difference(graph, output, unit, float(np.max(ours != near, initial=0)), 0.0, 0, share)
    scale = 1.0 if unit in ("px", "rad") else max(1.0, float(np.nanmax(np.abs(far), initial=0)))
    flips = int(np.sum(np.isfinite(ours) != np.isfinite(near)))
    share = float(np.mean(np.isfinite(ours) != np.isfinite(far))) if ours.size else 0.0
    return Difference(graph, output, unit, _largest(ours, near) / scale, _largest(ours, far) / scale, flips, share)


def _missing_share(expected: NDArray[Any], found: NDArray[Any]) -> float:
    """Return the share of expected corner positions (B, N, 2) that are not exactly among those found, less a tolerance
    of 1 %; at least 0.
    """
    known = [{tuple(point) for point in points[np.isfinite(points).all(-1)].tolist()} for points in (expected, found)]
    absent = len(known[0] - known[1]) / max(1, len(known[0]))
    return max(0.0, absent - _MOST_FLIPS)


def _largest(ours: NDArray[Any], other: NDArray[Any]) -> float:
    both = np.isfinite(ours) & np.isfinite(other)
    return float(np.max(np.abs(ours[both].astype(np.float64) - other[both]), initial=0.0))


def _tolerable(row: Difference) -> bool:
    near, far = _TOLERANCES.get(row.output, _RELATIVE)
    return row.to_torch <= near and row.to_float64 <= far and row.flips == 0 and row.share <= _MOST_FLIPS
