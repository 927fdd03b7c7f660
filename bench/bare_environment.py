"""Virtual environments with few packages, like those of a lab PC that only runs the player."""

import os
import shutil
import subprocess
import sys
import venv
from importlib.metadata import files
from pathlib import Path

ONNX = ("numpy", "onnxruntime", "flatbuffers", "protobuf", "packaging")  # onnxruntime and what it needs at run time


def make_environment(home: Path, distributions: tuple[str, ...]) -> Path:
    """Make a virtual environment with links to distributions that are installed here; return the path of its Python."""
    venv.EnvBuilder(symlinks=sys.platform != "win32").create(home)
    python = home / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    add_distributions(python, distributions)
    return python


def add_distributions(python: Path, distributions: tuple[str, ...]) -> None:
    """Link distributions that are installed here into the environment of a Python, as `pip install` there would."""
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    packages = Path(subprocess.check_output([python, "-c", ask], text=True).strip())
    for distribution in distributions:
        for top in {path.parts[0] for path in files(distribution) or () if path.parts[0] not in ("..", "__pycache__")}:
            if (packages / top).exists():
                continue
            found = next(Path(place, top) for place in sys.path if Path(place, top).exists())
            try:
                (packages / top).symlink_to(found, found.is_dir())
            except (OSError, NotImplementedError):  # Windows without the right to make links
                shutil.copytree(found, packages / top) if found.is_dir() else shutil.copy(found, packages / top)


def variables() -> dict[str, str]:
    """Return this process's environment variables without those that lead a Python elsewhere."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
