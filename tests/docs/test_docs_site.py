"""Tests of the site: scripts of the gallery run, links lead somewhere, and nothing is loaded from elsewhere."""

import re
import shutil
import subprocess
import sys
import tomllib
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlparse

import pytest

import fingerflow
from fingerflow.pipeline.dictionary import dictionary
from fingerflow.schema.scene_tables import SCENE

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[2]


class Page(HTMLParser):
    """Links, anchors and loaded files of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.leads: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        if "id" in given:
            self.anchors.add(given["id"])
        if tag == "a" and "href" in given:
            self.leads.append(given["href"])
        elif tag == "link" and given.get("rel") not in ("canonical", "index", "search", "next", "prev"):
            self.loads.append(given.get("href", ""))
        elif "src" in given:
            self.loads.append(given["src"])


@pytest.fixture(scope="module")
def site() -> Path:
    """Return the folder of the site, built from nothing as `make docs` builds it, which then has nothing left to do."""
    for module in ("sphinx", "furo", "myst_parser", "sphinx_gallery"):
        pytest.importorskip(module, reason="the site is not built: pip install '.[docs]'")
    for name in ("site", "generated"):
        shutil.rmtree(ROOT / "docs" / name, ignore_errors=True)
    options = ["-W", "--keep-going", "-q", "-d", "docs/site/.doctrees"]
    command = [sys.executable, "-m", "sphinx", *options, "docs", "docs/site"]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    return ROOT / "docs" / "site"


def pages_of(site: Path) -> dict[Path, Page]:
    return {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}


def test_every_script_of_the_gallery_holds_against_the_truth_and_draws(site: Path) -> None:
    """The build fails where an assertion of a script does."""
    scripts = sorted(ROOT.glob("docs/gallery/*.py"))
    assert len(scripts) >= 12
    assert not [path for path in scripts if not (site / "_images" / f"sphx_glr_{path.stem}_001.png").exists()]


def test_every_link_within_the_site_leads_somewhere(site: Path) -> None:
    pages = pages_of(site)
    assert len(pages) > 25
    wrong = []
    for path, page in pages.items():
        for link in page.leads:
            parts = urlparse(link)
            if parts.scheme:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists():
                wrong.append(f"{path.name}: {link}")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
                wrong.append(f"{path.name}: {link} has no such anchor")
    assert not wrong


def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    for path, page in pages_of(site).items():
        for source in page.loads:
            parts = urlparse(source)
            assert not parts.netloc, f"{path.name} loads {source}"
            assert parts.scheme == "data" or (path.parent / unquote(parts.path)).exists(), f"{path.name}: {source}"
    for sheet in site.rglob("*.css"):
        assert not re.search(r"(@import|url\()\s*['\"]?(https?:)?//", sheet.read_text(encoding="utf-8")), sheet.name


def test_equations_are_mathml(site: Path) -> None:
    text = (site / "methods" / "deformation.html").read_text(encoding="utf-8")
    assert text.count("<math") > 10
    assert "\\frac" not in re.sub(r"<annotation.*?</annotation>", "", text, flags=re.DOTALL)


def test_every_variable_and_key_has_its_place(site: Path) -> None:
    outputs = (site / "generated" / "outputs.html").read_text(encoding="utf-8")
    assert not [entry for entry in dictionary() if f"{entry['name']}<" not in outputs]
    keys = (site / "generated" / "keys.html").read_text(encoding="utf-8")
    assert not [name for name in SCENE if f"[{name}]<" not in keys]


def test_versions_are_equal() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert project["version"] == fingerflow.__version__
    assert re.search(rf"^version: {re.escape(fingerflow.__version__)}$", citation, re.MULTILINE)
    recipe = (ROOT / "docs" / "release" / "recipe.yaml").read_text(encoding="utf-8")
    assert f"  version: {fingerflow.__version__}\n" in recipe
    assert f"## {fingerflow.__version__}" in changes


def test_the_conda_recipe_has_the_dependencies() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    recipe = (ROOT / "docs" / "release" / "recipe.yaml").read_text(encoding="utf-8")
    names = {"torch": "pytorch", "opencv-contrib-python-headless": "py-opencv", "matplotlib": "matplotlib-base"}
    needed = [re.split("(?=>=)", one) for one in project["dependencies"]]
    assert not [name for name, least in needed if f"    - {names.get(name, name)} {least}\n" not in recipe]
