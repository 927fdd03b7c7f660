"""Tests of the three files of the live page, read as text and parsed as JavaScript."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from fingerflow.player import page_server as page

FOLDER = Path(page.__file__).with_name("page")
HTML, CSS, JS = ((FOLDER / name).read_text(encoding="utf-8") for name in ("index.html", "page.css", "page.js"))
IDS = re.findall(r'\bid="(\w+)"', HTML)


def test_ids_of_the_script_are_in_the_page() -> None:
    """Every id that the script looks up, always by `$("id")`, is in the page once."""
    asked = set(re.findall(r'\$\("([^"]+)"\)', JS))
    assert {"contact", "topography", "numbers", "state", "said", "restart", "truth"} <= asked
    drawn = re.findall(r'trace\(live, "(\w+)"', JS)  # each trace has a card, a legend and a title of its name
    assert drawn == ["areas", "forces", "divergence"]
    asked |= {name + part for name in drawn for part in ("", "Card", "Legend", "Title")}
    assert asked <= set(IDS)
    assert len(IDS) == len(set(IDS))
    assert JS.count("getElementById") == 1
    assert "querySelector" not in JS


def test_nothing_comes_from_elsewhere() -> None:
    """The page loads its files from its own server only, and works without a network."""
    assert not re.search(r"https?:|//[a-z]|@import|url\(", HTML + CSS + re.sub(r"//.*", "", JS))
    own = {path.removeprefix("/") for path in page._FILES}
    loaded = re.findall(r'\b(?:src|href)="([^"]+)"', HTML)
    assert {one for one in loaded if not one.startswith("data:")} == own - {""}
    assert set(re.findall(r'fetch\("(\w+)"', JS)) == {"live", "restart", "shown"}
    assert {name for name, _ in page._FILES.values()} == {file.name for file in FOLDER.iterdir()}


def test_the_script_reads_what_the_stream_sends() -> None:
    """The names of arrays and scalars in the script are those of the records, which the table of variables defines."""
    from fingerflow.schema.variables import CONTACT, FIELDS, STREAM, TRACKING, by_name

    known = {
        *by_name(CONTACT, FIELDS, STREAM, TRACKING),
        "topography_view",
        "contact_view",
        "real_contact_mask",
        "traces",
    }
    taken = {name for names in re.findall(r"const \{ ([^}]+) \} = live\.data", JS) for name in names.split(", ")}
    assert taken
    assert taken <= known
    scalars = set(re.findall(r"\b(?:s|live\.scalars)\.(\w+)", JS))
    assert scalars == {"ellipse_angle", "slip_flag"}
    table = re.search(r"const CELLS = \[(.*?)\]", JS)
    cells = set(re.findall(r'"(\w+)"', table[1] if table else ""))
    assert cells == {"real_contact_area", "gross_contact_area", "median_divergence"}
    traced = set(re.findall(r'\["(\w+)", "#', JS))
    assert traced == cells
    assert scalars | cells <= known


def test_what_is_expected_has_a_name_on_the_page() -> None:
    from fingerflow.player.live_data import SHOWN
    from fingerflow.player.sources.synthetic_source import Synthetic, side_by_side

    expected = Synthetic(side_by_side(32, 40), np.dtype(np.uint8), 8, 0.4).expected_in(0, 1)
    axes = re.search(r"const AXES = \{(.*?)\}", JS)
    assert set(expected) <= set(SHOWN) | set(re.findall(r"(\w+): ", axes[1] if axes else ""))


def test_the_script_is_javascript() -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node here, whose parser would read the script; the test in a browser runs it")
    ended = subprocess.run([node, "--check", str(FOLDER / "page.js")], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert JS.startswith('"use strict";')
