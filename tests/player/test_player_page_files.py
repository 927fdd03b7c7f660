"""Tests of the three files of the live page, read as text and parsed as JavaScript."""

import re
import shutil
import subprocess
from pathlib import Path

from fingerflow.player import page_server as page

FOLDER = Path(page.__file__).with_name("page")
HTML, CSS, JS = ((FOLDER / name).read_text(encoding="utf-8") for name in ("index.html", "page.css", "page.js"))


def test_nothing_comes_from_elsewhere() -> None:
    """The page loads its files from its own server only, and works without a network."""
    assert not re.search(r"https?:|//[a-z]|@import|url\(", HTML + CSS + re.sub(r"//.*", "", JS))
    if node := shutil.which("node"):
        subprocess.run([node, "--check", str(FOLDER / "page.js")], check=True)
    own = {path.removeprefix("/") for path in page._FILES}
    loaded = re.findall(r'\b(?:src|href)="([^"]+)"', HTML)
    assert {one for one in loaded if not one.startswith("data:")} == own - {""}
    assert set(re.findall(r'\bask\("(\w+)"', JS)) == {"live", "restart", "shown"}
    assert {name for name, _ in page._FILES.values()} == {file.name for file in FOLDER.iterdir()}
