"""A lab PC: an environment with few packages, and a bundle."""

import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

from bench.bare_environment import ONNX, make_environment, variables

ENGINES = ("onnx", "native")


class LabPC(NamedTuple):
    """A Python, the folder of a bundle, and the options that choose its engine."""

    python: Path
    bundle: Path
    options: tuple[str, ...]

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run Python with these arguments in the folder of the bundle."""
        command = [self.python, *arguments]
        return subprocess.run(command, cwd=self.bundle, env=variables(), capture_output=True, text=True, check=False)

    def play(self, output: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run the player with these arguments, with results in a folder `output` and without the live page."""
        always = ("--output", str(output), "--page", "off", "--threads", "1", *self.options)
        return self.run("-m", "fingerflow.player", *always, *arguments)


def set_up(folder: Path, bundle: Path, engine: str) -> LabPC:
    """Make an environment with NumPy, and onnxruntime where the engine is `onnx`, and copy a bundle beside it."""
    shutil.copytree(bundle, folder / "bundle")
    python = make_environment(folder / "env", ONNX if engine == "onnx" else ("numpy",))
    return LabPC(python, folder / "bundle", ("--engine", engine))
