"""The graphs of a recipe as ONNX files in a folder that a lab PC runs without torch.

Every graph is tried before the folder appears: ONNX Runtime on the processor against torch in the recipe's precision
and in float64, on a press and on hard cases. Only standard operators of opset 18 are used, and no control flow.
"""

import contextlib
import hashlib
import importlib.metadata
import importlib.util
import json
import logging
import secrets
import shutil
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from fingerflow.errors import FingerflowError
from fingerflow.stream.graphs import UNITS, Graph, build
from fingerflow.stream.recipe import GraphName, Recipe, load_recipe
from fingerflow.stream.trial import cases, feed

OPSET = 18  # newer ones make execution providers fall back to the processor without a word
FORMAT = 1  # of the bundle
COORDINATES = (
    "points are (x, y) px with integer pixel centres, x to the right, y down; angles from x towards y; images are "
    "(batch, 1, height, width)"
)
_BYTE = 2  # uint8 among the types of ONNX
_CONTROL_FLOW = {"Loop", "If", "Scan"}
_PLAYER_FILES = ("README.md", "requirements.txt", "scene.toml")


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
class Tolerance:
    """Largest differences to torch in the same precision and to float64; what one graph passes on is not its error."""

    to_torch: float
    to_float64: float


# Points: a position of 640 px has steps of 6e-5 px in float32; 1e-3 px is what the project promises. Fields: rounding
# of a position over a gauge length of tens of px. All but px and rad is relative to the largest number of the output:
# points that jump by tens of px have strains far beyond 1.
_TOLERANCES = {
    **dict.fromkeys(("points", "error", "center", "semi_axes"), Tolerance(1e-3, 1e-3)),
    **dict.fromkeys(("divergence", "curl", "strain", "median_divergence"), Tolerance(2e-4, 2e-4)),
    **dict.fromkeys(("threshold", "angle", "deviation"), Tolerance(1e-4, 1e-3)),
}
_RELATIVE = Tolerance(1e-4, 1e-3)
_MOST_FLIPS = 1e-2  # share of decisions (touching, tracked, returned) that rounding may turn against float64


def export_bundle(path: Path, folder: Path, progress: bool = False) -> list[Difference]:
    """Writes the bundle of a recipe file.

    Args:
        path: the recipe.
        folder: where to write; must not exist.
        progress: show a bar.

    Returns:
        What the verification found, one row an output.

    Raises:
        FingerflowError: a recipe that is wrong, a folder that exists, packages that are missing, or a graph that does
            not give what torch gives; then nothing is written.
    """
    recipe = load_recipe(path)
    _need("onnx", "onnxscript", "onnxruntime")
    if folder.exists():
        raise FingerflowError(f"{folder} exists already; name another folder or remove it")
    part = folder.with_name(f".{folder.name}-{secrets.token_hex(4)}")
    try:
        part.mkdir(parents=True)
        graphs = build(recipe)
        models = {
            name: write_graph(recipe, name, graph, part)
            for name, graph in tqdm(graphs.items(), "export", disable=not progress)
        }
        found = verify(recipe, part)
        _bundle(recipe, models, part)
        part.replace(folder)
    except OSError as error:
        raise FingerflowError(
            f"{folder} cannot be written ({error.strerror or error}); name another place, or make room there"
        ) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return found


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
            # Each graph gets the same inputs in all three, those that torch computed: errors do not pass on.
            known = dict(case.inputs)
            for name in sessions:
                graph = graphs[name]
                if any(one not in known and one not in ("topography_view",) for one in graph.inputs):
                    known.update(_missing(recipe, known))
                tensors = feed(name, graph, known)
                with torch.inference_mode():
                    reference = graph.module(*tensors)
                    double = exact[name].module(*(_double(one) for one in tensors))
                arrays = {one: tensor.numpy() for one, tensor in zip(graph.inputs, tensors, strict=True)}
                inputs = {one.name for one in sessions[name].get_inputs()}
                results = sessions[name].run(list(graph.outputs), {k: v for k, v in arrays.items() if k in inputs})
                for output, ours, near, far in zip(graph.outputs, results, reference, double, strict=True):
                    row = _difference(name, output, ours, near.numpy(), far.numpy())
                    key = (name, output)
                    worst[key] = row if key not in worst else _worse(worst[key], row)
                if name in ("background", "key"):
                    known.update(zip(graph.outputs, reference, strict=True))
    rows = list(worst.values())
    wrong = [row for row in rows if not _tolerable(row)]
    if wrong:
        raise FingerflowError(
            "ONNX Runtime and torch differ by more than rounding explains; nothing was written:\n" + as_text(wrong)
        )
    return rows


def as_text(rows: list[Difference]) -> str:
    """A table of the largest differences."""
    head = f"{'graph':<11}{'output':<20}{'unit':<9}{'to torch':>11}{'to float64':>12}{'NaN flips':>11}{'int share':>11}"
    lines = [
        f"{row.graph:<11}{row.output:<20}{row.unit[:8]:<9}{row.to_torch:>11.2g}{row.to_float64:>12.2g}{row.flips:>11}"
        f"{row.share:>11.2g}"
        for row in rows
    ]
    return "\n".join((head, *lines))


def _missing(recipe: Recipe, known: dict[str, Tensor]) -> dict[str, Tensor]:
    """Results of `background` and `key` where the recipe leaves these graphs out."""
    everything = build(
        recipe.model_copy(update={"export": recipe.export.model_copy(update={"graphs": ("background", "key")})})
    )
    found: dict[str, Tensor] = {}
    with torch.inference_mode():
        for name, graph in everything.items():
            found.update(zip(graph.outputs, graph.module(*feed(name, graph, known)), strict=True))
    return found


def _double(tensor: Tensor) -> Tensor:
    return tensor.double() if tensor.is_floating_point() else tensor


def _difference(graph: str, output: str, ours: NDArray[Any], near: NDArray[Any], far: NDArray[Any]) -> Difference:
    unit = UNITS[output]
    if output == "status":
        # Whether a point is tracked. Why it is not may turn on the last digit: far from any root, steps are chaotic.
        ours, near, far = (values != 0 for values in (ours, near, far))
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


def write_graph(recipe: Recipe, name: GraphName, graph: Graph, folder: Path) -> dict[str, str]:
    """Exports, checks and saves one graph; its entry in bundle.json."""
    import onnx
    import onnxscript.optimizer

    dynamic = recipe.views.batch == "dynamic"
    # An example of one would be taken for a constant.
    batch = 2 if recipe.views.batch == "dynamic" else recipe.views.batch
    known = dict(cases(recipe, batch)[0].inputs)
    if any(one not in known and one != "topography_view" for one in graph.inputs):
        known.update(_missing(recipe, known))
    # A tensor that stands for two inputs would be taken for one.
    tensors = tuple(tensor.clone() for tensor in feed(name, graph, known))
    shapes = None
    if dynamic:
        batched = {0: torch.export.Dim.DYNAMIC}
        shapes = (tuple({} if one == "topography_to_contact" else batched for one in graph.inputs),)
    with _quiet():
        program = torch.onnx.export(
            graph.module,
            tensors,
            dynamo=True,
            opset_version=OPSET,
            input_names=list(graph.inputs),
            output_names=list(graph.outputs),
            dynamic_shapes=shapes,
            custom_translation_table={torch.ops.fingerflow.nearest_byte.default: _nearest_byte},
            optimize=False,
            verbose=False,
        )
    assert program is not None
    # The exporter's own optimisation also looks for patterns of transformers, which takes longer than all the rest.
    for _ in range(2):
        onnxscript.optimizer.fold_constants(program.model)
        onnxscript.optimizer.remove_unused_nodes(program.model)
    model = program.model_proto
    for node in model.graph.node:  # stack traces of this machine
        node.doc_string = ""
        del node.metadata_props[:]
    for value in (*model.graph.value_info, *model.graph.input, *model.graph.output, *model.graph.initializer):
        value.doc_string = ""
        del value.metadata_props[:]
    del model.metadata_props[:], model.graph.metadata_props[:]
    model.doc_string = model.graph.doc_string = ""
    model.producer_name, model.producer_version = "fingerflow", _version()
    model.graph.name = f"fingerflow.{name}"
    foreign = {
        f"{node.domain}:{node.op_type}" for node in model.graph.node if node.domain or node.op_type in _CONTROL_FLOW
    }
    if foreign or model.functions or [opset.version for opset in model.opset_import] != [OPSET]:
        raise FingerflowError(f"the graph {name} is not of standard operators of opset {OPSET}: {sorted(foreign)}")
    digest = hashlib.sha256(model.SerializeToString(deterministic=True)).hexdigest()
    facts = {
        "version": _version(),
        "graph": name,
        "recipe": recipe.model_dump_json(),
        "units": json.dumps({one: UNITS[one] for one in (*graph.inputs, *graph.outputs)}),
        "coordinates": COORDINATES,
        "hash": digest,
    }
    onnx.helper.set_model_props(model, {f"fingerflow.{key}": value for key, value in facts.items()})
    onnx.checker.check_model(model, full_check=True)
    file = folder / f"{name}.onnx"
    file.write_bytes(model.SerializeToString(deterministic=True))
    return {"file": file.name, "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}


def _nearest_byte(values: Any) -> Any:
    import onnxscript

    operators: Any = onnxscript.opset18
    zero = operators.Cast(operators.Constant(value_int=0), to=_BYTE)
    return operators.QuantizeLinear(values, operators.Constant(value_float=1.0), zero)


def _bundle(recipe: Recipe, models: dict[GraphName, dict[str, str]], folder: Path) -> None:
    """Adds the player, what a technician reads, and bundle.json."""
    about = {"format": FORMAT, "fingerflow": _version(), "recipe": recipe.model_dump(), "graphs": models}
    (folder / "bundle.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    package = resources.files("fingerflow")
    (folder / "player.py").write_bytes((package / "player.py").read_bytes())
    for name in _PLAYER_FILES:
        (folder / name).write_bytes((package / "bundle" / name).read_bytes())


def _version() -> str:
    try:
        return importlib.metadata.version("fingerflow-engine")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def _need(*packages: str) -> None:
    missing = [name for name in packages if importlib.util.find_spec(name) is None]
    if missing:
        raise FingerflowError(f"export needs {', '.join(missing)}: pip install 'fingerflow-engine[export]'")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """The exporter warns of what it does not need and logs every step."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
