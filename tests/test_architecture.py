"""Data goes one way: recordings, stages (through graphs and ops), result, report. Imports are read, not run."""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "fingerflow"

# What each room may import of the others; itself always. A new file or folder takes its place here.
ARROWS: dict[str, set[str]] = {
    "errors": set(),
    "contract": set(),  # of scenes and results: below the player, of Python's own modules alone
    "digest": set(),
    "strict": set(),
    "toml_string": set(),
    "untrusted": {"errors"},
    "views": {"contract", "errors"},
    "atomic_write": {"contract", "errors"},
    "kernels": set(),  # of NumPy arrays and tensors, without torch
    "tensors": {"kernels"},  # the same as ops of torch's, in fingerflow/kernels/tensors
    "ops": {"kernels", "tensors"},
    "graphs": {"kernels", "ops"},
    "engines": {"errors", "kernels"},  # of NumPy arrays
    "torch_engine": {"engines", "errors", "graphs", "kernels", "ops", "tensors"},  # fingerflow/engines/torch.py
    "choice": {"engines", "errors", "kernels", "tensors", "torch_engine"},  # torch only for recordings
    "tracker": {"contract", "engines", "kernels"},
    "models": {"errors", "tensors"},
    "recordings": {"contract", "digest", "errors", "untrusted"},
    "calibration": {"atomic_write", "contract", "errors", "recordings", "toml_string", "views"},
    "scene": {"contract", "errors", "toml_string", "views"},
    "room": {"contract", "errors"},
    "store": {"contract", "room"},
    "stages": {
        "choice",
        "contract",
        "engines",
        "errors",
        "graphs",
        "kernels",
        "models",
        "ops",
        "recordings",
        "room",
        "scene",
        "store",
        "torch_engine",
        "tracker",
        "views",
    },
    "plan": {"contract", "errors", "scene", "stages"},
    "result": {"atomic_write", "errors", "room", "untrusted"},
    "dictionary": {"contract", "stages"},
    "tables": {"atomic_write", "errors"},
    "deviations": {"contract", "store"},
    "reuse": {"__init__", "digest", "errors", "tensors", "plan", "recordings", "stages", "store"},
    "pipeline": {
        "__init__",
        "atomic_write",
        "choice",
        "contract",
        "deviations",
        "engines",
        "errors",
        "export",
        "plan",
        "recordings",
        "result",
        "reuse",
        "room",
        "scene",
        "stages",
        "store",
        "torch_engine",
    },
    "synthetic": {"contract", "errors", "models", "scene", "views"},
    "comparison": {"ops", "synthetic"},
    "plot": {"errors", "graphs", "recordings", "scene", "stages"},
    "report": {
        "atomic_write",
        "errors",
        "models",
        "ops",
        "plot",
        "recordings",
        "result",
        "scene",
        "synthetic",
        "views",
    },
    "export": {
        "contract",
        "engines",
        "errors",
        "graphs",
        "kernels",
        "ops",
        "strict",
        "synthetic",
        "tensors",
        "tracker",
    },
    "player": {
        "choice",
        "contract",
        "engines",
        "kernels",
        "tracker",
        "errors",
        "recordings",
    },
    "study": {
        "__init__",
        "atomic_write",
        "contract",
        "digest",
        "engines",
        "errors",
        "models",
        "pipeline",
        "plot",
        "recordings",
        "report",
        "result",
        "reuse",
        "scene",
        "stages",
        "synthetic",
        "toml_string",
    },
    "stream_result": {"contract", "errors", "player"},
    "view": {
        "__init__",
        "atomic_write",
        "calibration",
        "contract",
        "engines",
        "errors",
        "plan",
        "recordings",
        "result",
        "scene",
        "stages",
        "store",
        "untrusted",
        "views",
    },
    "__init__": {"pipeline", "recordings", "scene", "stream_result"},  # only when one of them is asked for, see below
}
ARROWS["cli"] = set(ARROWS)
ARROWS["__main__"] = {"cli"}

# Where what a room may import from elsewhere is part of its promise; Python's own modules always.
PACKAGES = {
    "errors": set(),
    "contract": set(),  # of scenes and results: below the player, of Python's own modules alone
    "views": set(),
    "kernels": {"numpy"},
    "tensors": {"torch"},
    "ops": {"torch", "kornia"},
    "graphs": {"torch"},
    "engines": {"numpy", "onnxruntime"},
    "torch_engine": {"numpy", "torch"},
    "tracker": {"numpy"},
    "player": {"numpy", "cv2"},  # cv2 only where it is installed, for videos
}


def imported(source: str) -> Iterator[tuple[int, str]]:
    """(line, module) of every import, also inside functions and of `import_module` with a text."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, name.name) for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: imports are absolute"
            assert node.module is not None
            if node.module == "fingerflow.kernels":  # of which one module is a room of its own
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
    """`from fingerflow import kernels` is a module; `from fingerflow import __version__` is a name of the package."""
    is_module = (PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").exists() or name in ARROWS
    return f"fingerflow.{name}" if is_module else "fingerflow.__init__"


def wrong_arrows(room: str, source: str, where: str = "") -> list[str]:
    """One sentence an import that the tables do not have."""
    wrong = []
    for line, module in imported(source):
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
    own = {("player", "contract"): "contract", ("kernels", "tensors"): "tensors", ("engines", "choice"): "choice"}
    own |= {("engines", "torch"): "torch_engine"}
    return own.get(tuple(parts[:2]), parts[0])


def test_every_room_has_its_place() -> None:
    rooms = {room_of(path) for path in PACKAGE.rglob("*.py")}
    assert rooms <= set(ARROWS), "a new room: say in ARROWS what it may import"


def test_imports_follow_the_arrows() -> None:
    files = sorted(PACKAGE.rglob("*.py"))
    assert len(files) > 50
    wrong = [
        sentence
        for path in files
        for sentence in wrong_arrows(room_of(path), path.read_text(encoding="utf-8"), str(path.relative_to(PACKAGE)))
    ]
    assert not wrong, "\n".join(wrong)


def test_nothing_imports_the_command_line() -> None:
    assert all("cli" not in targets for room, targets in ARROWS.items() if room not in ("cli", "__main__"))


def test_no_room_leads_back_to_itself() -> None:
    """The arrows themselves go one way."""
    arrows = ARROWS | {"__init__": set()}  # what that offers is loaded when it is asked for
    finished: set[str] = set()
    for _ in arrows:
        finished |= {room for room, targets in arrows.items() if targets - {room} <= finished}
    assert finished == set(arrows), f"a circle among {sorted(set(arrows) - finished)}"


def test_the_package_itself_loads_nothing() -> None:
    """`import fingerflow` is free; torch comes with the first public function."""
    tree = ast.parse((PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    loaded = [node for node in tree.body if isinstance(node, (ast.Import, ast.ImportFrom))]
    assert {node.module for node in loaded if isinstance(node, ast.ImportFrom)} <= {
        "importlib",
        "importlib.util",
        "typing",
    }
    assert not [node for node in loaded if isinstance(node, ast.Import)]


@pytest.mark.parametrize(
    ("room", "source"),
    [
        ("ops", "from fingerflow.graphs import ContactGraph"),
        ("ops", "import numpy as np"),
        ("ops", "def f():\n    from fingerflow import scene"),
        ("graphs", "import fingerflow.stages.contact"),
        ("kernels", "import torch"),
        ("kernels", "from fingerflow.kernels import tensors"),
        ("kernels", "from fingerflow.kernels.tensors.torch_op import torch_op"),
        ("models", "from fingerflow.ops.strain import curl"),
        ("recordings", "from fingerflow.stages.inputs import Inputs"),
        ("stages", "from fingerflow.pipeline import process"),
        ("report", "from fingerflow.cli import main"),
        ("player", "import torch"),
        ("calibration", 'import_module(f"fingerflow.report.{name}")'),
        ("views", "if TYPE_CHECKING:\n    from fingerflow.scene import Scene"),
    ],
)
def test_a_wrong_arrow_is_seen(room: str, source: str) -> None:
    assert len(wrong_arrows(room, source)) == 1
