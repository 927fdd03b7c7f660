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
from importlib import resources
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from fingerflow.errors import FingerflowError
from fingerflow.export.build import UNITS, Graph, build
from fingerflow.export.recipe import GraphName, Recipe, load_recipe
from fingerflow.export.trial import cases, feed
from fingerflow.export.verification import Difference, missing, verify

OPSET = 18  # newer ones make execution providers fall back to the processor without a word
FORMAT = 1  # of the bundle
COORDINATES = (
    "points are (x, y) px with integer pixel centres, x to the right, y down; angles from x towards y; images are "
    "(batch, 1, height, width)"
)
_BYTE = 2  # uint8 among the types of ONNX
_CONTROL_FLOW = {"Loop", "If", "Scan"}
_PLAYER_FILES = ("README.md", "requirements.txt", "scene.toml")


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


def write_graph(recipe: Recipe, name: GraphName, graph: Graph, folder: Path) -> dict[str, str]:
    """Exports, checks and saves one graph; its entry in bundle.json."""
    import onnx
    import onnxscript.optimizer

    dynamic = recipe.views.batch == "dynamic"
    # An example of one would be taken for a constant.
    batch = 2 if recipe.views.batch == "dynamic" else recipe.views.batch
    known = dict(cases(recipe, batch)[0].inputs)
    if any(one not in known and one != "topography_view" for one in graph.inputs):
        known.update(missing(recipe, known))
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
