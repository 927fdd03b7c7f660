"""Selection of the modules of the package that a deployment bundle contains, copied unchanged.

Imports are parsed, not executed. A bundle contains the modules of `WHOLE` and all that they import, at load time or
within functions, except modules that cannot be loaded with the packages of the lab PC because they need torch.
"""

import ast
import functools
import logging
import shutil
import sys
from collections.abc import Iterator
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]
ON_THE_LAB_PC = frozenset(("numpy", "onnxruntime", "tifffile"))  # third-party packages that may be needed at load time
WHOLE = ("player", "engines", "tracker")
_DATA = ("kernels/interface.h", "player/page/*")
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
log = logging.getLogger("fingerflow.export")


def carry_modules(bundle: Path) -> None:
    """Copy what the player needs into the folder `fingerflow` of a bundle: modules, live page, compiled library.

    A library that was not built is left out with a warning in the log. In the bundle its file name has no Python
    version, because it does not call Python.
    """
    modules = carried()
    rooms = {name.split(".")[1] for name in modules if "." in name}
    data = [file for pattern in _DATA if pattern.partition("/")[0] in rooms for file in PACKAGE.glob(pattern)]
    home = bundle / PACKAGE.name
    for file in (*modules.values(), *data):
        copy = home / file.relative_to(PACKAGE)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, copy)
    library = find_spec(f"{PACKAGE.name}._kernels")
    if library is None or library.origin is None:
        log.warning("the bundle has no compiled library: none was built here (no C++ compiler at install time?)")
    else:
        shutil.copyfile(library.origin, home / f"_kernels{EXTENSION_SUFFIXES[-1]}")


def carried() -> dict[str, Path]:
    """Return the files of the modules that a bundle carries, by name."""
    found: dict[str, Path] = {}
    waiting = [name for room in WHOLE for name in _modules_of(f"{PACKAGE.name}.{room}")]
    while waiting:
        name = waiting.pop()
        if name not in found and needed_to_load(name) <= ON_THE_LAB_PC:
            found[name] = _files()[name]
            waiting += [one for one, _ in _imports_of(name) if one in _files()]
    return dict(sorted(found.items()))


def needed_to_load(name: str) -> set[str]:
    """Return the third-party packages that are imported when a module of this package is loaded."""
    needed, seen, waiting = set(), set[str](), [name]
    while waiting:
        one = waiting.pop()
        if one not in seen:
            seen.add(one)
            at_loading = [other for other, later in _imports_of(one) if not later]
            waiting += [other for other in at_loading if other in _files()]
            needed |= {other.partition(".")[0] for other in at_loading}
    return needed - sys.stdlib_module_names - {PACKAGE.name}


@functools.cache
def _files() -> dict[str, Path]:
    """Return the file of every module of the package, by name."""
    files = {}
    for file in PACKAGE.rglob("*.py"):
        parts = file.relative_to(PACKAGE.parent).with_suffix("").parts
        files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return files


def _modules_of(package: str) -> list[str]:
    return [name for name in _files() if name == package or name.startswith(f"{package}.")]


@functools.cache
def _imports_of(name: str) -> tuple[tuple[str, bool], ...]:
    """Return (name, later) of all that a module imports, including the packages that contain it.

    ``later`` is true for imports within functions. A name that `from` imports may be an attribute or a module.
    """
    above = name.split(".")
    around = ((".".join(above[:count]), False) for count in range(1, len(above)))
    return (*around, *_imports(ast.parse(_files()[name].read_text(encoding="utf-8")), False))


def _imports(tree: ast.AST, later: bool) -> Iterator[tuple[str, bool]]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.Import):
            yield from ((one.name, later) for one in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield node.module, later
            yield from ((f"{node.module}.{one.name}", later) for one in node.names)
        elif isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) == "import_module":
            yield from ((one, later) for one in _by_text(node.args[0]))
        yield from _imports(node, later or isinstance(node, _FUNCTIONS))


def _by_text(argument: ast.expr) -> list[str]:
    """Return the modules that `import_module` may load: for an f-string, all of the package that it begins with."""
    if isinstance(argument, ast.Constant):
        return [str(argument.value)]
    first = argument.values[0] if isinstance(argument, ast.JoinedStr) else None
    return _modules_of(str(first.value).rstrip(".")) if isinstance(first, ast.Constant) else []
