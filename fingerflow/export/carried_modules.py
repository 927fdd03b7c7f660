"""Selection of the modules of the package that a deployment bundle contains, copied unchanged.

A bundle contains the modules of `ROOMS` that load where only `ON_THE_LAB_PC` is installed. A separate Python tries it.
"""

import logging
import shutil
import subprocess
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]
# Third-party packages that a bundle's modules may import on the lab computer: those of the player and those that
# onnxruntime needs.
ON_THE_LAB_PC = ("numpy", "onnxruntime", "tifffile", "flatbuffers", "google", "packaging")
ROOMS = ("engines", "errors", "kernels", "player", "recordings", "results", "schema", "tracker")
_DATA = ("player/page/*", "recordings/frames/*.txt")
_LOADABLE = """
import sys
from importlib import import_module
installed = {*sys.argv[1].split(), *sys.stdlib_module_names, "fingerflow"}
class NothingElse:
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] not in installed:
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, NothingElse)
for name in sys.argv[2:]:
    try:
        import_module(name)
    except ImportError:
        continue
    print(name)
"""
log = logging.getLogger("fingerflow.export")


def carry_modules(bundle: Path) -> None:
    """Copy into a bundle what the player needs: modules, live page and compiled library.

    The folder is `fingerflow` in the bundle. A library that was not built is left out with a warning in the log. In the
    bundle its file name has no Python version, because it does not call Python.
    """
    home = bundle / PACKAGE.name
    for file in (*modules_to_carry().values(), *(file for pattern in _DATA for file in PACKAGE.glob(pattern))):
        copy = home / file.relative_to(PACKAGE)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, copy)
    library = find_spec(f"{PACKAGE.name}._kernels")
    if library is None or library.origin is None:
        log.warning("the bundle has no compiled library: none was built here (no C++ compiler at install time?)")
    else:
        shutil.copyfile(library.origin, home / f"_kernels{EXTENSION_SUFFIXES[-1]}")


def modules_to_carry() -> dict[str, Path]:
    """Return the source files of the modules that a bundle contains, by module name."""
    files = {}
    for file in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
        if name == PACKAGE.name or name.split(".")[1] in ROOMS:
            files[name] = file
    command = [sys.executable, "-c", _LOADABLE, " ".join(ON_THE_LAB_PC), *files]
    ended = subprocess.run(command, cwd=PACKAGE.parent, capture_output=True, text=True, check=True)
    return {name: files[name] for name in ended.stdout.split()}
