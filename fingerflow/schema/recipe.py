"""Recipe of a deployment bundle: settings of the exported graphs, in a TOML file with keys as those of a scene."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from fingerflow.schema.key_types import BOTH, number, several
from fingerflow.schema.keys import SceneTable, key, keys_of, table
from fingerflow.schema.scene import line_number, parse_toml
from fingerflow.schema.scene_check import TableCheck
from fingerflow.schema.scene_tables import ContactCells, EngineSettings, GaugeSettings, PointSettings
from fingerflow.schema.text_file import read_text

GraphName = Literal[
    "contact", "threshold", "noise", "detect", "spline", "prepare", "renew", "track", "track_few", "support", "correct",
    "outliers", "search", "windows", "fields", "fields_entered", "fit",
]  # fmt: skip
#: Graphs of a bundle, in an order in which an engine can run them.
GRAPHS: tuple[GraphName, ...] = get_args(GraphName)
_SIDE = number(least=48, most=4096)  # px of a view: counts of pixels are exact in float32 up to 2^24


@dataclass(frozen=True)
class ViewRecipe:
    """Settings [views] of a recipe: size of both views in px, and bit depth.

    Pixels are uint8 for 8 bits, else uint16.
    """

    height: int = key("of a view", type=_SIDE, needed_by=BOTH, unit="px")
    width: int = key("of a view", type=_SIDE, needed_by=BOTH, unit="px")
    bit_depth: int = key("bits of a pixel", 8, number(least=8, most=16))


@dataclass(frozen=True)
class ExportRecipe:
    """Settings [export] of a recipe: the graphs to export."""

    graphs: tuple[GraphName, ...] = key("to export", GRAPHS, several(GRAPHS))


@dataclass(frozen=True)
class Recipe:
    """Recipe of a deployment bundle: all tables of settings of a recipe file."""

    views: ViewRecipe = table("size of both views", BOTH)
    contact: ContactCells = table("segmentation of contact", default=ContactCells())
    tracking: PointSettings = table("points on the skin", default=PointSettings())
    fields: GaugeSettings = table("deformation of the skin", default=GaugeSettings())
    export: ExportRecipe = table("graphs of the bundle", default=ExportRecipe())

    @property
    def engine_settings(self) -> EngineSettings:
        """Return the settings of the engine; the strain measure is the default."""
        return EngineSettings(**vars(self.contact), **vars(self.tracking), **vars(self.fields))


class _Check(TableCheck):
    missing = "is missing; add it: recipes such as export/exact.toml show how"

    def check_rules(self) -> None:
        """Check that views have room for the points, and that a graph that searches has a reach."""
        height, width, points = map(self.find_value, ("views.height", "views.width", "tracking.points"))
        if height and width and points and points > height * width // 16:
            size = f"views of {height} x {width} px hold no more than {height * width // 16}"
            self.record_conflict("tracking.points", size)
        if self.find_value("tracking.search_px") == 0:
            self.record_conflict("tracking.search_px", "the graph search of a bundle needs a reach; give at least 1")


def load_recipe(path: Path) -> Recipe:
    """Read and validate a recipe file, and return its settings.

    Raises:
        FingerflowError: the file cannot be read, is not valid TOML, or has an unknown key or a value out of range; with
            the file, the line and the key.
    """
    text = read_text(path, "recipes are TOML files such as export/exact.toml")
    return parse_recipe(parse_toml(text, path), path, text)


def parse_recipe(written: Mapping[str, Any], path: Path = Path("recipe"), text: str = "") -> Recipe:
    """Return the recipe with the given tables and keys, parsed from the file `path` with this text; raise errors as
    :func:`load_recipe`.
    """
    check, tables = _Check(written, path.parent, "process"), SceneTable(keys=keys_of(Recipe), settings=Recipe)
    check.values = check.table((), tables, written)
    check.check_rules()
    check.raise_problems(lambda keys: f"{path}, line {line_number(text, keys)}" if text else str(path))
    return tables.build(check.values)
