"""Tests of the imports of the package, which are read and not run: data goes one way, from recordings through stages
(with graphs and ops) to result and report.
"""

import ast
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from fingerflow.schema import variables

PACKAGE = Path(__file__).resolve().parents[1] / "fingerflow"

# Rooms (folders or files of the package) that each room may import, beside itself. A new file or folder needs a row.
_TABLE = {
    "errors": "",
    "schema": "errors",  # keys of scenes, variables of results
    "recordings": "errors schema",
    "results": "errors recordings schema",
    "kernels": "",  # works on NumPy arrays and tensors without importing torch
    "tensors": "kernels",  # the kernels as ops of torch, in fingerflow/kernels/tensors
    "ops": "kernels tensors",
    "graphs": "kernels ops schema",
    "engines": "errors kernels schema",  # works on NumPy arrays
    "torch_engine": "engines errors graphs kernels ops schema tensors",  # see `_room`
    "choice": "engines errors kernels tensors torch_engine",  # torch only for recordings
    "tracker": "engines kernels recordings schema",
    "recorded": "engines kernels recordings schema tracker",  # what of the tracker serves recordings alone
    "models": "errors tensors",
    "calibration": "errors recordings results schema",
    "stages": "choice engines errors export graphs kernels models ops recorded recordings results schema torch_engine "
    "tracker",
    "pipeline": "__init__ choice engines errors recordings results schema stages tensors torch_engine",
    "synthetic": "errors models ops schema",
    "plot": "errors graphs ops recordings results schema stages",
    "report": "errors models plot recordings results schema",
    "export": "__init__ engines errors graphs kernels ops schema tensors torch_engine",
    "player": "choice engines errors kernels recordings results schema tracker",
    "study": "__init__ engines errors kernels models pipeline plot recordings report results schema stages synthetic",
    "view": "__init__ calibration engines errors kernels pipeline player recordings results schema stages",
    "__init__": "pipeline recordings results schema",  # only on access to one of their names, see below
}
ARROWS = {room: set(others.split()) for room, others in _TABLE.items()}
ARROWS["cli"] = set(ARROWS)
ARROWS["__main__"] = {"cli"}

# Packages that these rooms may import, beside Python's own modules.
PACKAGES = {
    "errors": set(),
    "schema": set(),
    "kernels": {"numpy"},
    "tensors": {"torch"},
    "ops": {"torch", "kornia"},
    "graphs": {"torch"},
    "engines": {"numpy", "onnxruntime"},
    "torch_engine": {"numpy", "torch"},
    "tracker": {"numpy"},
    "recorded": {"numpy", "cv2", "scipy"},
    # All but NumPy are optional: for videos and cameras, outputs and sensors.
    "player": {"numpy", "cv2", "harvesters", "pylsl", "serial", "zmq"},
}


@cache
def _tree(path: Path) -> ast.AST:
    return ast.parse(path.read_text(encoding="utf-8"))


def imported(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield (line, module) of every import, also inside functions and by `import_module` with a text."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, name.name) for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: imports are absolute"
            assert node.module is not None
            if node.module == "fingerflow.kernels":  # one of its modules is a room of its own
                yield from ((node.lineno, f"fingerflow.kernels.{name.name}") for name in node.names)
            elif node.module == "fingerflow":
                yield from ((node.lineno, _member(name.name)) for name in node.names)
            else:
                yield node.lineno, node.module
        elif isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) == "import_module":
            argument = node.args[0].values[0] if isinstance(node.args[0], ast.JoinedStr) else node.args[0]
            if isinstance(argument, ast.Constant):
                yield node.lineno, str(argument.value).rstrip(".")


def _member(name: str) -> str:
    """Return the module of a name imported from `fingerflow`: `kernels` is a module itself, `__version__` is a name of
    the package.
    """
    is_module = (PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").exists() or name in ARROWS
    return f"fingerflow.{name}" if is_module else "fingerflow.__init__"


def wrong_arrows(room: str, tree: ast.AST, where: str = "") -> list[str]:
    """Return one sentence for each import that the tables do not allow."""
    wrong = []
    for line, module in imported(tree):
        top, _, rest = module.partition(".")
        if top == "fingerflow":
            target = _room(rest.split(".")) or "__init__"
            if target != room and target not in ARROWS[room]:
                wrong.append(f"{where}:{line}: {room} may not import {module}; it may import {sorted(ARROWS[room])}")
        elif room in PACKAGES and top not in PACKAGES[room] and top not in sys.stdlib_module_names:
            wrong.append(f"{where}:{line}: {room} may not import {module}; it may import {sorted(PACKAGES[room])}")
    return wrong


def room_of(path: Path) -> str:
    return _room([part.removesuffix(".py") for part in path.relative_to(PACKAGE).parts])


def _room(parts: list[str]) -> str:
    own = {("pipeline", "stages"): "stages", ("kernels", "tensors"): "tensors", ("engines", "choice"): "choice"}
    own |= {("engines", "torch"): "torch_engine", ("tracker", "recorded"): "recorded"}
    return own.get(tuple(parts[:2]), parts[0])


def test_no_class_name_twice() -> None:
    """Every class of the package has a name of its own, so that a name in a message or docstring leads to one class."""
    named: dict[str, list[str]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(_tree(path)):
            if isinstance(node, ast.ClassDef):
                named.setdefault(node.name, []).append(f"{path.relative_to(PACKAGE)}:{node.lineno}")
    assert not {name: places for name, places in named.items() if len(places) > 1}


def test_every_variable_is_put_under_its_literal_name() -> None:
    """The name of every variable of results stands literally in a stage, the tracker or the player, or has a formula
    beside its definition, so that a search for the name finds where it is computed.
    """
    texts = {
        node.value
        for room in ("pipeline/stages", "tracker", "player")
        for path in (PACKAGE / room).rglob("*.py")
        for node in ast.walk(_tree(path))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    every = [one for value in vars(variables).values() if isinstance(value, tuple) for one in value]
    computed = {one.name for one in every if isinstance(one, variables.Variable) and one.formula is None}
    assert len(computed) > 60
    assert not computed - texts


def test_imports_follow_the_arrows() -> None:
    files = sorted(PACKAGE.rglob("*.py"))
    assert len(files) > 50
    assert {room_of(path) for path in files} <= set(ARROWS), "a new room: say in ARROWS what it may import"
    wrong = [one for path in files for one in wrong_arrows(room_of(path), _tree(path), str(path.relative_to(PACKAGE)))]
    assert not wrong, "\n".join(wrong)


def test_no_room_leads_back_to_itself() -> None:
    """The allowed imports have no circle."""
    arrows = ARROWS | {"__init__": set()}  # the package loads its names on first access
    finished: set[str] = set()
    for _ in arrows:
        finished |= {room for room, targets in arrows.items() if targets - {room} <= finished}
    assert finished == set(arrows), f"a circle among {sorted(set(arrows) - finished)}"


def test_the_package_itself_loads_nothing() -> None:
    """`import fingerflow` loads nothing; torch is loaded with the first public function."""
    loaded = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8")).body
    modules = [getattr(node, "module", "") for node in loaded if isinstance(node, (ast.Import, ast.ImportFrom))]
    assert set(modules) <= {"importlib", "importlib.util", "os", "typing"}


def test_the_unit_in_which_a_variable_is_shown_stands_in_its_record_alone() -> None:
    """Figures, reports and pages take the displayed unit of a variable from `schema`; otherwise one quantity could have
    several units.
    """
    pages = [path for kind in ("py", "js", "html") for path in PACKAGE.rglob(f"*.{kind}")]
    assert len(pages) > 300
    stated = {str(path.relative_to(PACKAGE)) for path in pages if "µm/mm" in path.read_text(encoding="utf-8")}
    assert {name for name in stated if not name.startswith("schema/")} == set()


#: Stems of several files that hold the same subject: for tensors and for arrays, or of two commands.
_SAME_THING = {"__main__", "block_means", "cells", "checks", "deformation", "frame_distances", "window_match"}


def test_files_of_one_stem_hold_the_same_thing() -> None:
    """Files of equal name hold the same subject, as twins in `kernels`, `engines` or `tracker`."""
    stems: dict[str, list[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        if path.stem != "__init__":
            stems.setdefault(path.stem, []).append(str(path.relative_to(PACKAGE)))
    assert {stem for stem, files in stems.items() if len(files) > 1} <= _SAME_THING, stems
