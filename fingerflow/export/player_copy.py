"""What a bundle plays with: the player's folder as it is, and the package's readers of recordings inside it.

The readers are the package's own files, those that need NumPy alone and the one of TIFF, which needs tifffile. Only the
names under which they import each other differ: a bundle is played where no fingerflow is.
"""

import re
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

READERS = (
    "errors.py",
    "untrusted/files.py",
    *(
        f"recordings/frames/{name}.py"
        for name in ("cine", "cine_companding", "mraw", "npy", "opening", "packing", "recording", "tiff")
    ),
)
_OF_PLAYER, _OF_PACKAGE = re.compile(r"\bfingerflow\.player\."), re.compile(r"\bfingerflow\.(?=[a-z])")
_ABOUT = '"""Readers of recordings of the package fingerflow, copied by `fingerflow export`."""\n'


def copy_player(folder: Path) -> None:
    """Writes the folder `player` into a folder."""
    package = resources.files("fingerflow")
    _copy(package / "player", folder / "player")
    home = folder / "player" / "readers"
    for name in READERS:
        text = (package / name).read_text(encoding="utf-8")
        file = home / name
        for parent in (file.parent, *file.parent.parents):
            if not parent.is_relative_to(home):
                break
            parent.mkdir(parents=True, exist_ok=True)
            (parent / "__init__.py").write_text(_ABOUT, encoding="utf-8")
        text = _OF_PACKAGE.sub("player.readers.", _OF_PLAYER.sub("player.", text))
        file.write_text(text, encoding="utf-8")


def _copy(source: Traversable, folder: Path) -> None:
    """A folder with everything in it, but for what Python has compiled of it."""
    folder.mkdir()
    for one in source.iterdir():
        if one.is_file():
            (folder / one.name).write_bytes(one.read_bytes())
        elif one.name != "__pycache__":
            _copy(one, folder / one.name)
