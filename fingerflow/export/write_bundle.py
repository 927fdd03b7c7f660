"""Export of a recipe to a deployment bundle: a folder of ONNX files that a lab PC runs without torch.

Every graph is verified before the folder is created: ONNX Runtime on the CPU has to give the numbers of torch by the
start check of the player. Only standard operators of opset 18 are used, without control flow.
"""

import hashlib
import json
import re
import shutil
from collections.abc import Mapping
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from tqdm import tqdm

from fingerflow import __version__
from fingerflow.engines.check import Difference, built_in, check_engine, expected_of, numbers_of
from fingerflow.engines.engine import ANY_NUMBER
from fingerflow.engines.graph_engine import GraphEngine
from fingerflow.engines.sessions import open_sessions
from fingerflow.engines.torch import TorchEngine
from fingerflow.errors import FingerflowError
from fingerflow.export.build import UNITS, build_graphs
from fingerflow.export.carried_modules import carry_modules
from fingerflow.export.portable import Portable, PortableSession
from fingerflow.export.standard_model import need_packages, standard_model
from fingerflow.graphs.engine_graphs import Graph
from fingerflow.schema.bundle_format import BUNDLE_FORMAT, COORDINATES
from fingerflow.schema.recipe import GraphName, Recipe, load_recipe
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
        The differences found by the verification, one row a result.

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
        views, settings = recipe.views, recipe.engine_settings
        size = (views.height, views.width, views.bit_depth, recipe.tracking.points)
        sessions = {name: PortableSession(graph) for name, graph in build_graphs(recipe).items()}
        numbers_of(GraphEngine(sessions, settings, size[-1]), built_in(*size, settings.window_px))
        for name in tqdm(recipe.export.graphs, "export", disable=not progress):
            write_graph(recipe, name, sessions[name].graph, tuple(sessions[name].inputs.values()), part)
        with torch.inference_mode(), Portable():
            expected = expected_of(TorchEngine(settings, torch.device("cpu")), *size)
        differences = verify(recipe, part, sessions, expected)
        _bundle(recipe, expected, part)
        finish(part, folder)
    except OSError as error:
        raise FingerflowError(
            f"{folder} cannot be written ({error.strerror or error}); name another place, or make room there"
        ) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return differences


def verify(
    recipe: Recipe, folder: Path, sessions: Mapping[GraphName, PortableSession], expected: Mapping[str, Any]
) -> list[Difference]:
    """Check that ONNX Runtime gives the expected numbers of the built-in frame with the exported graphs of a recipe in
    a folder, as a player does when it starts, and return the differences; `sessions` run the graphs that were not
    exported.
    """
    files = {str(name): folder / f"{name}.onnx" for name in recipe.export.graphs}
    opened: dict[Any, Any] = {**sessions, **open_sessions(files)}
    return check_engine(GraphEngine(opened, recipe.engine_settings, recipe.tracking.points), expected)


def as_text(rows: list[Difference]) -> str:
    """Return the largest differences between ONNX Runtime and torch as a text table, one row for each result."""
    lines = ["{result:<20}{difference:>11.2g}{tolerance:>11.2g} {unit}".format(**row) for row in rows]
    return "\n".join((f"{'result':<20}{'to torch':>11}{'at most':>11}", *lines))


def write_graph(recipe: Recipe, name: GraphName, graph: Graph, tensors: tuple[Tensor, ...], folder: Path) -> None:
    """Export one graph to an ONNX file in a folder, for inputs of the shapes of `tensors`, and check the file."""
    import onnx

    # Clone the inputs: the exporter would merge two inputs that are the same tensor.
    model = standard_model(graph, tuple(map(torch.clone, tensors)), graph.inputs, graph.outputs, name in ANY_NUMBER)
    model.producer_name, model.producer_version = "fingerflow", __version__
    model.graph.name = f"fingerflow.{name}"
    facts = {
        "version": __version__,
        "graph": name,
        "recipe": json.dumps(asdict(recipe)),
        "units": json.dumps({name: UNITS[name] for name in (*graph.inputs, *graph.outputs)}),
        "coordinates": COORDINATES,
        "hash": hashlib.sha256(model.SerializeToString(deterministic=True)).hexdigest(),
    }
    onnx.helper.set_model_props(model, {f"fingerflow.{key}": value for key, value in facts.items()})
    onnx.checker.check_model(model, full_check=True)
    (folder / f"{name}.onnx").write_bytes(model.SerializeToString(deterministic=True))


def _bundle(recipe: Recipe, expected: Mapping[str, Any], folder: Path) -> None:
    """Write all files of a bundle except the graphs: the player, the files for technicians and bundle.json, which has
    the `expected` numbers of the built-in frame and the SHA-256 of every file but scene.toml, which users edit.
    """
    package = resources.files("fingerflow")
    carry_modules(folder)
    for name in _PLAYER_FILES:
        (folder / name).write_bytes((package / "export" / "template" / name).read_bytes())
    write_facts(asdict(recipe), expected, folder)
    scene = (package / "export" / "template" / "scene.toml").read_text(encoding="utf-8")
    (folder / "scene.toml").write_text(scene_for(scene, recipe.views.height, recipe.views.width), encoding="utf-8")


def write_facts(recipe: Mapping[str, Any], expected: Mapping[str, Any], folder: Path) -> None:
    """Write bundle.json: version, recipe, `expected` numbers, and the SHA-256 of every file that is in the folder."""
    files = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}
    stated = {table: {key: value for key, value in keys.items() if value is not None} for table, keys in recipe.items()}
    facts = {
        "format": BUNDLE_FORMAT,
        "fingerflow": __version__,
        "recipe": stated,
        "files": {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()},
        "expected": expected,
    }
    (folder / "bundle.json").write_text(json.dumps(facts) + "\n", encoding="utf-8")


def scene_for(template: str, height: int, width: int) -> str:
    """Return the text of a scene template, made for two views of 512 x 640 px side by side, adapted to views of height
    x width px.
    """
    replacements = {
        "[0, 512]": (0, height),
        "[0, 640]": (0, width),
        "[640, 1280]": (width, 2 * width),
        "[100, 400]": (height // 5, 4 * height // 5),
        "[100, 540]": (width // 5, 4 * width // 5),
    }
    return re.sub("|".join(map(re.escape, replacements)), lambda match: str(list(replacements[match[0]])), template)
