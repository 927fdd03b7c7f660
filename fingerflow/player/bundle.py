"""Deployment bundle: the folder that `fingerflow export` writes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fingerflow.engines.bundle_settings import bundle_settings
from fingerflow.engines.engine import EngineSettings
from fingerflow.engines.names import GRAPHS
from fingerflow.errors import PlayerError
from fingerflow.schema.bundle_format import BUNDLE_FORMAT


@dataclass(frozen=True)
class Bundle:
    """Deployment bundle whose files match their hashes; `expected` is used by `engines.check`."""

    folder: Path
    recipe: Mapping[str, Any]
    version: str
    hashes: Mapping[str, str]
    files: Mapping[str, Path]
    expected: Mapping[str, Any]  # results of the built-in frame (`engines.check`)

    @property
    def height(self) -> int:
        """Return the height of a view in px."""
        return int(self.recipe["views"]["height"])

    @property
    def width(self) -> int:
        """Return the width of a view in px."""
        return int(self.recipe["views"]["width"])

    @property
    def bit_depth(self) -> int:
        """Return the bits of a pixel, 8 to 16."""
        return int(self.recipe["views"]["bit_depth"])

    @property
    def points(self) -> int:
        """Return the largest number of points in a frame."""
        return int(self.recipe["tracking"]["points"])

    @property
    def engine_settings(self) -> EngineSettings:
        """Return the settings with which its graphs were exported."""
        return bundle_settings(self.recipe)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Return the data type of a pixel."""
        return np.dtype(np.uint8 if self.bit_depth == 8 else np.uint16)


def load_bundle(folder: Path) -> Bundle:
    """Return the bundle of a folder after checking every graph's file against its hash; raise PlayerError."""
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
        graphs = facts["graphs"]
        bundle = Bundle(
            folder=folder,
            recipe=facts["recipe"],
            version=str(facts["fingerflow"]),
            hashes={name: graphs[name]["sha256"] for name in GRAPHS},
            files={name: folder / graphs[name]["file"] for name in GRAPHS},
            expected=facts["expected"],
        )
        _ = bundle.height, bundle.width, bundle.dtype, bundle.points, bundle.engine_settings
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise PlayerError(
            f"{path}: has no proper entry {error}; a stream needs the graphs {', '.join(GRAPHS)}: {again}"
        ) from None
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
