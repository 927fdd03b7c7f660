"""Tests that the commented scene file, the form of the page and the list of keys agree with the table of keys."""

import re
import tomllib
from collections.abc import Iterator
from typing import Any

import pytest

from fingerflow.schema.key_list import key_list
from fingerflow.schema.key_types import File
from fingerflow.schema.keys import SceneKey, SceneTable
from fingerflow.schema.scene_kinds import KINDS
from fingerflow.schema.scene_tables import SCENE, views_of
from fingerflow.schema.scene_template import scene_text
from fingerflow.schema.views import View
from fingerflow.view.key_forms import forms

TABLES = {**SCENE, "views": views_of(KINDS["press"])}
REGION = View((1, 20), (3, 40))


def entries(table: SceneKey | SceneTable, name: str) -> Iterator[tuple[str, SceneKey]]:
    if isinstance(table, SceneKey):
        yield name, table
    else:
        for key, one in table.keys.items():
            yield from entries(one, f"{name}.{key}")


ENTRIES = dict(entry for name, table in TABLES.items() for entry in entries(table, name))


def everything_written() -> dict[str, Any]:
    """Return the commented scene file as a dictionary, with keys and tables uncommented."""
    text = re.sub(r"^# (?=[a-z_]+ = |\[)", "", scene_text(), flags=re.M)
    return tomllib.loads(text)


@pytest.mark.parametrize("name", ENTRIES)
def test_every_key_says_what_it_means_and_shows_a_value_that_is_accepted(name: str) -> None:
    key = ENTRIES[name]
    assert len(key.help.split()) > 1
    shown: Any = everything_written()
    for part in name.split("."):
        if part not in shown and name.startswith(("views", "calibration.topo")):
            return  # a region is shown by one of its three keys
        shown = shown[part]
    assert isinstance(shown, str) if isinstance(key.type, File) else key.type.convert(shown) is not None


def test_keys_with_a_default_are_written_with_it() -> None:
    written = tomllib.loads(scene_text())
    assert {"forces", "slip", "stream"}.isdisjoint(written)
    for table in ("contact", "tracking", "fields"):
        assert written[table] == {
            name.partition(".")[2]: key.default for name, key in ENTRIES.items() if name.startswith(f"{table}.")
        }


def test_what_is_given_is_written_and_nothing_else_of_an_optional_table() -> None:
    written = tomllib.loads(
        scene_text(forces='a "b".csv', region=REGION, slip=True, frame_rate=40.0, calibration="mm_per_px = 0.03")
    )
    assert written["forces"]["file"] == 'a "b".csv'
    assert written["stream"] == {"region": {"rows": [1, 20], "columns": [3, 40]}}
    assert written["recording"] == {"frames": "frames.cine", "frame_rate": 40.0}
    assert written["calibration"] == {"mm_per_px": 0.03}
    assert "criterion" in written["slip"]


def test_the_form_of_the_page_and_the_list_of_keys_have_the_same_help_and_default() -> None:
    listed = key_list()
    assert set(listed) == set(ENTRIES)
    assert {name: key[-1] for name, key in listed.items()} == {name: key.help for name, key in ENTRIES.items()}
    form = {key["name"]: key for key in forms()["fields"]["keys"]}
    assert form["gauge_length_mm"]["label"] == "gauge length (mm)"
    assert form["gauge_length_mm"]["help"] == ENTRIES["fields.gauge_length_mm"].help
    assert listed["recording.frame_rate"][0] == "number > 1e-06 Hz"
