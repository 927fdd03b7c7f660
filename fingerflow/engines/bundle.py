"""Reading of a deployment bundle: the folder of ONNX graphs and settings that `fingerflow export` writes."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from fingerflow.engines.engine import EngineSettings
from fingerflow.errors import PlayerError
from fingerflow.schema.bundle_format import BUNDLE_FORMAT
from fingerflow.schema.keys import keys_of

GraphName = Literal[
    "contact",
    "threshold",
    "noise",
    "detect",
    "spline",
    "prepare",
    "renew",
    "track",
    "track_few",
    "support",
    "correct",
    "outliers",
    "search",
    "windows",
    "fields",
    "fields_entered",
    "fit",
]
#: Graphs of a bundle, in an order in which an engine can run them.
GRAPHS: tuple[GraphName, ...] = get_args(GraphName)


@dataclasses.dataclass(frozen=True)
class Bundle:
    """Content of a deployment bundle, whose graph files have been checked against their hashes.

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
    """Load the deployment bundle of a folder and check the hash of every graph file.

    Raise PlayerError for a missing, damaged or foreign file.
    """
    path = folder / "bundle.json"
    again = "export the bundle again, or copy its folder again"
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise PlayerError(
            f"{path}: cannot be read ({error.strerror}); name the folder that `fingerflow export` wrote"
        ) from None
    except (ValueError, RecursionError) as error:
        raise PlayerError(f"{path}: is no JSON ({error}); {again}") from None
    if not isinstance(facts, dict) or facts.get("format") != BUNDLE_FORMAT:
        found = facts.get("format") if isinstance(facts, dict) else facts
        raise PlayerError(
            f"{path}: its format is {found!r}, this player reads {BUNDLE_FORMAT}; use the player of the same bundle, "
            "or export it again"
        )
    try:
        graphs, recipe = facts["graphs"], facts["recipe"]
        bundle = Bundle(
            folder=folder,
            recipe=recipe,
            version=str(facts["fingerflow"]),
            hashes={name: graphs[name]["sha256"] for name in graphs},
            files={name: folder / graphs[name]["file"] for name in graphs},
            expected=facts["expected"],
            **{name: int(recipe["views"][name]) for name in ("height", "width", "bit_depth")},
            points=int(recipe["tracking"]["points"]),
            engine_settings=bundle_settings(recipe),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise PlayerError(f"{path}: has no proper entry {error}; {again}") from None
    for name, file in bundle.files.items():
        try:
            digest = hashlib.sha256(file.read_bytes()).hexdigest()
        except OSError as error:
            raise PlayerError(f"{file}: cannot be read ({error.strerror}); {again}") from None
        if digest != bundle.hashes[name]:
            raise PlayerError(
                f"{file}: its SHA-256 is {digest[:16]}..., bundle.json has {bundle.hashes[name][:16]}...: the file is "
                f"damaged or belongs to another bundle; {again}"
            )
    return bundle


def bundle_settings(recipe: Mapping[str, Any]) -> EngineSettings:
    """Return the engine settings of a deployment bundle, given the recipe in bundle.json.

    The strain measure is the default.
    """
    stated = {**recipe["contact"], **recipe["tracking"], **recipe["fields"]}
    return EngineSettings(**{name: stated[name] for name in keys_of(EngineSettings)})
