"""Run the player of an exported bundle as a separate process, as on a lab PC."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from bench.bare_environment import variables
from fingerflow.export import export_bundle

_RECIPES = Path(__file__).parents[1] / "export"


@contextmanager
def exported(recipe: str) -> Iterator[Path]:
    """Yield the bundle of a recipe, given as the text of its file, and delete it afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recipe.toml"
        path.write_text(recipe, encoding="utf-8")
        export_bundle(path, Path(folder) / "bundle")
        yield Path(folder) / "bundle"


@contextmanager
def exported_recipes() -> Iterator[dict[str, Path]]:
    """Yield the bundle of each recipe of `export/` by the recipe's name, and delete them afterwards."""
    with ExitStack() as held:
        yield {
            path.stem: held.enter_context(exported(path.read_text(encoding="utf-8")))
            for path in sorted(_RECIPES.glob("*.toml"))
        }


def play(
    bundle: Path,
    engine: str = "native",
    *,
    scene: Path | None = None,
    results: Path | None = None,
    frames: int | None = None,
    rate: int | None = None,
    provider: str | None = None,
    python: Path | str = sys.executable,
    watch: Callable[[int], None] = lambda pid: None,
    watch_s: float = 0.1,
) -> dict[str, Any]:
    """Play the synthetic source, or the recording of a scene, and return the summary of the stream.

    By default all frames are played as fast as it goes, and records are not kept: ``rate`` is in frames a second,
    ``results`` a folder. ``watch`` is called with the process id every ``watch_s`` seconds. The processor time of the
    player, its start included, is added to the summary as "cpu_s".

    Raises RuntimeError with the player's log where it ends with an error.
    """
    with tempfile.TemporaryDirectory() as folder:
        options = {
            "--engine": engine,
            "--source": None if scene else "synthetic",
            "--scene": scene,
            "--page": "off",
            "--output": results or f"{folder}/results",
            "--json": f"{folder}/summary.json",
            "--frames": frames,
            "--rate": rate,
            "--provider": provider,
        }
        given = [str(word) for option in options.items() if option[1] is not None for word in option]
        command = [str(python), "-m", "fingerflow.player", *given]
        log, before = Path(folder) / "log", _seconds_of_children()
        with (
            log.open("w") as file,
            subprocess.Popen(command, cwd=bundle, env=variables(), stdout=file, stderr=file) as running,
        ):
            while running.poll() is None:
                watch(running.pid)
                time.sleep(watch_s)
        if running.returncode:
            raise RuntimeError(log.read_text())
        summary: dict[str, Any] = json.loads(Path(folder, "summary.json").read_text())
        return summary | {"cpu_s": _seconds_of_children() - before}


def _seconds_of_children() -> float:
    """Return the processor time of all ended child processes, s."""
    times = os.times()
    return times.children_user + times.children_system
