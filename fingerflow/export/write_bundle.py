"""Export of a recipe to a deployment bundle: a folder of ONNX files that a lab PC runs without torch.

Every graph is verified before the folder is created: ONNX Runtime on the CPU against torch in the recipe's precision
and in float64, on a press and on hard cases. Only standard operators of opset 18 are used, without control flow.
"""

import hashlib
import json
import re
import shutil
from dataclasses import asdict
from importlib import resources
from pathlib import Path

import torch
from tqdm import tqdm

from fingerflow import __version__
from fingerflow.engines.bundle import bundle_settings
from fingerflow.engines.check import expected_of
from fingerflow.engines.torch import TorchEngine
from fingerflow.errors import FingerflowError
from fingerflow.export.build import UNITS, Graph, build
from fingerflow.export.carried_modules import carry_modules
from fingerflow.export.graph_verification import Difference, verify
from fingerflow.export.portable import Portable
from fingerflow.export.recipe import GraphName, Recipe, load_recipe
from fingerflow.export.standard_model import need_packages, standard_model
from fingerflow.export.verification_frames import cases, complete_inputs, inputs_of
from fingerflow.schema.bundle_format import BUNDLE_FORMAT, COORDINATES
from fingerflow.schema.unfinished import finish, unfinished

_PLAYER_FILES = ("README.md", "requirements.txt")


def export_bundle(path: Path, folder: Path, progress: bool = False) -> list[Difference]:
    """Export a recipe file to a deployment bundle: write a new folder with verified ONNX graphs, the player and its
    files.

    Args:
        path: the recipe.
        folder: where to write; must not exist.
        progress: show a progress bar.

    Returns:
        The differences found by the verification, one row an output.

    Raises:
        FingerflowError: an invalid recipe, an existing folder, missing packages, or a graph that differs from torch;
            then nothing is written.
    """
    recipe = load_recipe(path)
    need_packages()
    if folder.exists():
        raise FingerflowError(f"{folder} exists already; name another folder or remove it")
    part = unfinished(folder)
    try:
        part.mkdir(parents=True)
        graphs = {name: graph for name, graph in build(recipe).items() if name in recipe.export.graphs}
        models = {
            name: write_graph(recipe, name, graph, part)
            for name, graph in tqdm(graphs.items(), "export", disable=not progress)
        }
        found = verify(recipe, part)
        _bundle(recipe, models, part)
        finish(part, folder)
    except OSError as error:
        raise FingerflowError(
            f"{folder} cannot be written ({error.strerror or error}); name another place, or make room there"
        ) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return found


def write_graph(recipe: Recipe, name: GraphName, graph: Graph, folder: Path) -> dict[str, str]:
    """Export one graph to an ONNX file in a folder and check the file; return its name and SHA-256 hash for
    bundle.json.
    """
    import onnx

    dynamic = recipe.views.batch == "dynamic"
    # A dynamic batch is traced with 2, since the exporter would treat a batch of 1 as a constant.
    batch = 2 if recipe.views.batch == "dynamic" else recipe.views.batch
    known = complete_inputs(recipe, cases(recipe, batch)[0])
    # Clone the inputs: the exporter would merge two inputs that are the same tensor.
    tensors = tuple(tensor.clone() for tensor in inputs_of(name, graph, known).values())
    shapes = (tuple({0: torch.export.Dim.DYNAMIC} for _ in graph.inputs),) if dynamic else None
    model = standard_model(graph.module, tensors, graph.inputs, graph.outputs, shapes)
    model.producer_name, model.producer_version = "fingerflow", __version__
    model.graph.name = f"fingerflow.{name}"
    digest = hashlib.sha256(model.SerializeToString(deterministic=True)).hexdigest()
    facts = {
        "version": __version__,
        "graph": name,
        "recipe": json.dumps(asdict(recipe)),
        "units": json.dumps({one: UNITS[one] for one in (*graph.inputs, *graph.outputs)}),
        "coordinates": COORDINATES,
        "hash": digest,
    }
    onnx.helper.set_model_props(model, {f"fingerflow.{key}": value for key, value in facts.items()})
    onnx.checker.check_model(model, full_check=True)
    file = folder / f"{name}.onnx"
    file.write_bytes(model.SerializeToString(deterministic=True))
    return {"file": file.name, "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}


def _bundle(recipe: Recipe, models: dict[GraphName, dict[str, str]], folder: Path) -> None:
    """Write all files of a bundle except the graphs: the player, the files for technicians and bundle.json, which
    describes the graphs by `models`.
    """
    engine = TorchEngine(bundle_settings(asdict(recipe)), torch.device("cpu"))
    views = recipe.views
    with torch.inference_mode(), Portable():
        expected = expected_of(engine, views.height, views.width, views.bit_depth, recipe.tracking.points)
    about = {
        "format": BUNDLE_FORMAT,
        "fingerflow": __version__,
        "recipe": asdict(recipe),
        "graphs": models,
        "expected": expected,
    }
    (folder / "bundle.json").write_text(json.dumps(about) + "\n", encoding="utf-8")
    package = resources.files("fingerflow")
    carry_modules(folder)
    for name in _PLAYER_FILES:
        (folder / name).write_bytes((package / "export" / "template" / name).read_bytes())
    scene = (package / "export" / "template" / "scene.toml").read_text(encoding="utf-8")
    text = scene_for(scene, recipe.views.height, recipe.views.width)
    (folder / "scene.toml").write_text(text, encoding="utf-8")


def scene_for(template: str, height: int, width: int) -> str:
    """Return the text of a scene template, made for two views of 512 x 640 px side by side, adapted to views of height
    x width px.
    """
    places = {
        "[0, 512]": (0, height),
        "[0, 640]": (0, width),
        "[640, 1280]": (width, 2 * width),
        "[100, 400]": (height // 5, 4 * height // 5),
        "[100, 540]": (width // 5, 4 * width // 5),
    }
    return re.sub("|".join(map(re.escape, places)), lambda found: str(list(places[found[0]])), template)
