"""Reading of a deployment bundle: the folder of ONNX graphs and settings that `fingerflow export` writes."""

import hashlib
import json
import re
import sys
from collections.abc import Container, Mapping
from dataclasses import asdict, dataclass
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

import numpy as np

from fingerflow.engines.engine import EngineSettings
from fingerflow.errors import FingerflowError
from fingerflow.schema.bundle_format import BUNDLE_FORMAT
from fingerflow.schema.recipe import GRAPHS as GRAPHS  # `choice` may not import the schema, and takes it from here
from fingerflow.schema.recipe import parse_recipe
from fingerflow.schema.text_file import check_file, read_text

_AGAIN = "export the bundle again, or copy its folder again"
_MOST_BYTES = 1 << 31  # of a file, the most of an ONNX graph
_MOST_FACTS = 1 << 26  # bytes of bundle.json, which has some 100 kB for 700 points
_FILE_NAME = re.compile(r"(?!.*\.\.)\w[\w.+-]*(/\w[\w.+-]*)*")  # relative, below the folder on every system
_COMPILED = (".pyc", ".so", ".pyd", ".dll", ".dylib")


@dataclass(frozen=True)
class Bundle:
    """Content of a deployment bundle, whose files have been checked against their hashes.

    Attributes:
        height, width, bit_depth: of a view: px, px, and bits of a pixel, 8 to 16.
        points: largest number of points in a frame.
        hashes, files: SHA-256 and path of each graph, by name; the compiled library needs none of them.
        engine_settings: settings with which the graphs were exported.
        expected: results of the built-in frame (`engines.check`).
    """

    folder: Path
    recipe: Mapping[str, Any]
    version: str
    hashes: Mapping[str, str]
    files: Mapping[str, Path]
    expected: Mapping[str, Any]
    height: int
    width: int
    bit_depth: int
    points: int
    engine_settings: EngineSettings

    @property
    def dtype(self) -> np.dtype[Any]:
        """Return the data type of a pixel: uint8 for 8 bits, else uint16."""
        return np.dtype(np.uint8 if self.bit_depth == 8 else np.uint16)


def load_bundle(folder: Path) -> Bundle:
    """Load the deployment bundle of a folder and check the hash of every file that bundle.json lists.

    Raise FingerflowError for a missing, damaged or foreign file, and for code that bundle.json does not list.
    """
    path = folder / "bundle.json"
    try:
        facts = json.loads(read_text(path, "name the folder that `fingerflow export` wrote", _MOST_FACTS))
    except (ValueError, RecursionError) as error:
        raise FingerflowError(f"{path}: is no JSON ({error}); {_AGAIN}") from None
    if not isinstance(facts, dict) or facts.get("format") != BUNDLE_FORMAT:
        stated = facts.get("format") if isinstance(facts, dict) else facts
        raise FingerflowError(
            f"{path}: its format is {str(stated)[:40]!r}, this player reads {BUNDLE_FORMAT}; use the player of the "
            "same bundle, or export it again"
        )
    for name, entry_type in {"fingerflow": str, "recipe": dict, "files": dict, "expected": dict}.items():
        if not isinstance(facts.get(name), entry_type):
            raise FingerflowError(f"{path}: has no proper entry {name!r}; {_AGAIN}")
    try:
        recipe = parse_recipe(facts["recipe"], path)
        if not facts["files"]:
            raise FingerflowError(f"{path}: lists no file")
        _check_code(folder, facts["files"])
        for name, digest in facts["files"].items():
            _check_hash(folder, name, digest)
    except FingerflowError as error:
        raise FingerflowError(f"{error}; {_AGAIN}") from None
    size = {name: getattr(recipe.views, name) for name in ("height", "width", "bit_depth")}
    for name, number in {**size, "points": recipe.tracking.points}.items():
        if facts["expected"].get(name) != number:
            raise FingerflowError(f"{path}: its expected numbers are not of {name} {number} of its recipe; {_AGAIN}")
    files: dict[str, Path] = {name: folder / f"{name}.onnx" for name in GRAPHS if f"{name}.onnx" in facts["files"]}
    return Bundle(
        folder=folder,
        recipe=asdict(recipe),
        version=facts["fingerflow"],
        hashes={name: facts["files"][file.name] for name, file in files.items()},
        files=files,
        expected=facts["expected"],
        **size,
        points=recipe.tracking.points,
        engine_settings=recipe.engine_settings,
    )


def _check_code(folder: Path, listed: Container[str]) -> None:
    """Raise FingerflowError if there is code that is not `listed`: compiled code, a module in the package, or a module
    beside it that hides an installed one of its name. A camera's module of the user is none of these.
    """
    elsewhere = [entry for entry in sys.path if Path(entry).resolve() != folder.resolve()]
    package = [path for path in folder.glob("fingerflow/**/*") if path.parent.name != "__pycache__"]
    for path in (*package, *folder.iterdir(), *folder.glob("*/__init__.py")):
        name = path.relative_to(folder).as_posix()
        module = name.split("/")[0].split(".")[0]
        foreign = path.suffix in _COMPILED
        if path.suffix == ".py" or (path.is_symlink() and path.is_dir()):
            installed = PathFinder.find_spec(module, elsewhere)
            foreign = module in ("fingerflow", *sys.stdlib_module_names) or installed is not None
        if foreign and name not in listed:
            raise FingerflowError(f"{path}: is code that bundle.json does not list; remove it, or rename your module")


def _check_hash(folder: Path, name: str, digest: str) -> None:
    """Raise FingerflowError if the file of this name has another SHA-256, or if the name leads out of the bundle."""
    if not _FILE_NAME.fullmatch(name):
        raise FingerflowError(f"{folder / 'bundle.json'}: {name[:80]!r} is no name of a file in its folder")
    if (size := check_file(folder / name)) > _MOST_BYTES:
        raise FingerflowError(f"{folder / name}: has {size} bytes, more than any file of a bundle")
    actual = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    if actual != digest:
        raise FingerflowError(
            f"{folder / name}: its SHA-256 is {actual[:16]}..., bundle.json has {str(digest)[:16]}...: the file is "
            "damaged or belongs to another bundle"
        )
