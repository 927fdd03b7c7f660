"""The folder in which the scripts of the gallery run: a copy, as they write recordings beside themselves."""

import shutil
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[1]
SCRIPTS = DOCS / "generated" / "scripts"


def copy_scripts() -> str:
    """Copy the scripts of the gallery, and return the folder of the copies relative to that of the pages."""
    shutil.rmtree(SCRIPTS, ignore_errors=True)
    shutil.copytree(DOCS / "gallery", SCRIPTS)
    return str(SCRIPTS.relative_to(DOCS))


def remove_recordings(gallery: dict[str, Any], script: str, when: str) -> None:
    """Remove the recordings that a script of the gallery has written, for the next one writes its own."""
    for folder in SCRIPTS.iterdir():
        if folder.is_dir():
            shutil.rmtree(folder)
