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
    traced = set(re.findall(r'\["(\w+)", "#', JS))
    assert traced == {"real_contact_area", "gross_contact_area", "median_divergence"}
    assert scalars | traced <= known
