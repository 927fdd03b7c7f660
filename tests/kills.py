"""End commands at random moments, and check what they leave behind.

`python -m tests.kills`: each run starts a command beside an older output of its kind, or beside none, ends it, and
looks at the files. An output must be whole or absent, an output that was finished before must still be there, and a
refusal must be a sentence. Then the same command runs to its end, and nothing but its outputs may be left. Moments are
drawn by a seeded generator: a file that is opened, renamed, made or removed.

Commands are forked from a process that has imported all modules, and are small.
"""

import argparse
import contextlib
import importlib
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fingerflow import cli, open_stream, synthetic
from fingerflow.errors import FingerflowError
from fingerflow.export import write_bundle
from fingerflow.results import patient_file
from fingerflow.results.result import load_result
from tests.small_trials import TINY_PRESS

sys.path.insert(0, str(Path(__file__).resolve().parent / "player"))
import tiny_bundle

__all__ = ["ENDINGS", "main"]
#: Endings, and the exit codes of a command that ends so.
ENDINGS = {"SIGKILL": (0, -signal.SIGKILL), "SIGTERM": (0, -signal.SIGTERM, 143), "SIGINT": (0, 130, -signal.SIGINT)}
RECIPE = '[views]\nheight = 96\nwidth = 120\n[tracking]\npoints = 20\n[export]\ngraphs = ["noise"]\n'
_OPERATIONS = ("open", "os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.truncate", "shutil.rmtree")


@dataclass(frozen=True)
class Command:
    """A command that is run in a folder: its inputs there, its output, which it replaces or not, and whether the output
    is that of a run to the end.
    """

    arguments: tuple[str, ...]
    inputs: tuple[str, ...]
    output: str
    replaces: bool
    whole: Callable[[Path, Path], bool]


def _same_files(path: Path, reference: Path) -> bool:
    """Return whether two folders hold the same files: of a bundle files of the same names."""
    ours, theirs = ({one.relative_to(folder): one for one in folder.rglob("*")} for folder in (path, reference))
    bundle = (reference / "bundle.json").exists()
    return ours.keys() == theirs.keys() and (
        bundle or all(one.is_dir() or one.read_bytes() == theirs[name].read_bytes() for name, one in ours.items())
    )


def _readable_stream(path: Path, reference: Path) -> bool:
    """Return whether the results of a stream can be read and hold its frames from the first one on."""
    frames = open_stream(path).load()["frame"].values
    return np.array_equal(frames, np.arange(len(frames))) and len(frames) <= open_stream(reference).sizes["frame"]


STREAM = ("stream", "tiny", "--source", "synthetic", "--frames", "200", "--page", "off", "--threads", "1")
COMMANDS = {
    "process": Command(("process", "press/scene.toml", "--output", "result.h5"), ("press",), "result.h5", True,
                       lambda path, reference: load_result(path).equals(load_result(reference))),
    "simulate": Command(("simulate", "press", "made"), (), "made", False, _same_files),
    "export": Command(("export", "recipe.toml", "--output", "bundle"), ("recipe.toml",), "bundle", False, _same_files),
    "stream": Command((*STREAM, "--output", "played"), ("tiny",), "played", False, _readable_stream),
}  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.kills", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=100, help="runs (100)")
    parser.add_argument("--seed", type=int, default=16)
    parser.add_argument("--command", choices=COMMANDS, action="append", help="only this one; may be repeated")
    asked = parser.parse_args(arguments)
    rng, faults = random.Random(asked.seed), 0
    press = replace(TINY_PRESS, n_frames=24, frame_rate=24.0)
    synthetic.Press = lambda: press  # type: ignore[misc, assignment]
    patient_file._PATIENCE = 1.0  # s, instead of half a minute
    write_bundle.verify = lambda *_: []  # type: ignore[attr-defined]  # tested by tests/export
    with tempfile.TemporaryDirectory(prefix="kills-") as folder:
        top, names, endings = Path(folder), asked.command or list(COMMANDS), list(ENDINGS)
        operations = _references(top / "base", names)
        for number in range(asked.count):
            # Combine each command with each ending in turn.
            turn, which = divmod(number, len(names))
            name, ending = names[which], endings[(turn + which) % len(endings)]
            for fault in _run(COMMANDS[name], top, ending, rng, operations[name]):
                faults += 1
                print(f"{number} {name}, {ending}: {fault}", flush=True)
    print(f"{asked.count} runs, {faults} faults; endings: {', '.join(endings)}")
    return 1 if faults else 0


def _references(base: Path, names: list[str]) -> dict[str, int]:
    """Make the inputs and outputs of runs that are not ended; return the number of file operations of each command."""
    (base / "given").mkdir(parents=True)
    (base / "given" / "recipe.toml").write_text(RECIPE)
    tiny_bundle.write_bundle(base / "given" / "tiny")
    told = base / "told"
    assert _fork(("simulate", "press", "press"), base / "given", told)[0] == 0, told.read_text()
    operations = {}
    for name in names:
        for _ in range(2):  # the second run imports nothing
            shutil.rmtree(base / name, ignore_errors=True)
            _fill(base / name, COMMANDS[name], base)
            status, operations[name] = _fork(COMMANDS[name].arguments, base / name, told)
        assert status == 0, told.read_text()
    return operations


def _fill(folder: Path, command: Command, base: Path) -> None:
    folder.mkdir()
    for name in command.inputs:
        given = base / "given" / name
        shutil.copytree(given, folder / name) if given.is_dir() else shutil.copy(given, folder / name)


def _run(command: Command, top: Path, ending: str, rng: random.Random, operations: int) -> list[str]:
    """Run a command once and end it; return its faults, a sentence each."""
    folder, told, base = top / "run", top / "told", top / "base"
    reference = base / command.arguments[0] / command.output
    shutil.rmtree(folder, ignore_errors=True)
    _fill(folder, command, base)
    older = command.replaces and rng.random() < 0.5
    if older:
        shutil.copy(reference, folder / command.output)
    before = set(folder.rglob("*"))
    status, _ = _fork(command.arguments, folder, told, getattr(signal, ending), int(rng.random() * operations))
    said = told.read_text(errors="replace")
    state = _state(command, folder / command.output, reference)
    faults = []
    if state != "whole" and (older or state != "absent"):
        faults.append(f"{command.output} {'was finished before, and ' if older else ''}{state}")
    if status not in ENDINGS[ending] or "Traceback" in said:
        faults.append(f"ended with {status}: {said[-300:]}")
    if status in (0, 2, 130):  # the command had the time to clear up
        faults += _left_behind(folder, before, command)
    again, _ = _fork(command.arguments, folder, told)
    said = told.read_text(errors="replace")
    if again != 0 and not (again == 2 and not command.replaces and "exist" in said):
        faults.append(f"the next run ended with {again}: {said[-300:]}")
    if (state := _state(command, folder / command.output, reference)) != "whole":
        faults.append(f"after the next run {command.output} {state}")
    return faults + [f"after the next run: {one}" for one in _left_behind(folder, before, command)]


def _state(command: Command, path: Path, reference: Path) -> str:
    if not path.exists():
        return "absent"
    try:
        return "whole" if command.whole(path, reference) else "is there and not whole"
    except (FingerflowError, OSError, ValueError, KeyError) as error:
        return f"is there and cannot be read: {error}"


def _left_behind(folder: Path, before: set[Path], command: Command) -> list[str]:
    output = folder / command.output
    more = [str(one) for one in set(folder.rglob("*")) - before if one != output and output not in one.parents]
    return [f"left behind: {', '.join(sorted(more))}"] if more else []


def _fork(
    arguments: tuple[str, ...], folder: Path, told: Path, number: int | None = None, moment: int = -1
) -> tuple[int, int]:
    """Run a command in a process of its own, which gets the signal `number` at the file operation `moment`; return its
    status and its number of file operations.
    """
    reading, writing = os.pipe()
    sys.stdout.flush()
    process = os.fork()
    if not process:
        os.close(reading)
        _become(arguments, folder, told, number, moment, writing)
    os.close(writing)
    limit = threading.Timer(600.0, os.kill, (process, signal.SIGKILL))
    limit.start()
    try:
        with os.fdopen(reading, "rb") as answer:
            facts = answer.read()
        status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    finally:
        limit.cancel()
    operations, modules = json.loads(facts) if facts else (0, [])
    for module in modules:  # imported once here instead of in each process
        with contextlib.suppress(Exception):
            importlib.import_module(module)
    return status, operations


def _become(arguments: tuple[str, ...], folder: Path, told: Path, number: int | None, moment: int, answer: int) -> None:
    """Run the command in the new process, until it ends or is ended."""
    status, operations, known = 1, 0, set(sys.modules)

    def count(event: str, values: tuple[object, ...]) -> None:
        nonlocal operations
        if event not in _OPERATIONS or (event == "open" and not int(values[2]) & (os.O_WRONLY | os.O_RDWR)):  # type: ignore[call-overload]
            return
        operations += 1
        if number is not None and operations == moment + 1:
            os.kill(os.getpid(), number)

    try:
        out = os.open(told, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(out, 1)
        os.dup2(out, 2)
        os.chdir(folder)
        sys.argv = ["fingerflow", *arguments]
        sys.addaudithook(count)
        cli.main()
    except SystemExit as error:
        status = error.code if isinstance(error.code, int) else 1
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        modules = [name for name in sys.modules if name not in known and not name.startswith("__")]
        with os.fdopen(answer, "w") as writing:
            json.dump((operations, modules), writing)
        os._exit(status)


if __name__ == "__main__":
    sys.exit(main())
