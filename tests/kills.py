"""End commands at random moments, also on full and on read-only disks, and check what they leave behind.

`python -m tests.kills`: each run starts a command beside an older output of its kind, or beside none, ends it, and
looks at the files. An output must be whole or absent, an output that was finished before must still be there, and a
refusal must be a sentence. Then the same command runs to its end, and nothing but its outputs may be left. Moments are
drawn by a seeded generator: a processor time, or a file that is opened, renamed, made or removed. The disk is a file
system in memory, which needs the right to mount.

Commands are forked from a process that has imported all modules, and are small.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import functools
import importlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import xarray as xr

from fingerflow import cli, load_scene, open_stream
from fingerflow import player as playing
from fingerflow import report as reporting
from fingerflow.engines.bundle import load_bundle
from fingerflow.errors import FingerflowError
from fingerflow.export import write_bundle
from fingerflow.recordings.guard.idle import IdleLimit
from fingerflow.results import patient_file
from fingerflow.results import result as results
from fingerflow.results.atomic_write import is_marked
from tests.small_trials import TINY_PRESS

sys.path.insert(0, str(Path(__file__).resolve().parent / "player"))
import tiny_bundle

__all__ = ["ENDINGS", "main"]
DISK_BYTES = 200 << 20
KEPT_FREE = 64 << 20  # free bytes that results of HDF5 leave: fingerflow/results/free_space.py
ENDINGS = ("kill", "kill at a file", "SIGTERM", "SIGINT", "full disk", "freed disk", "read-only")
ON_A_DISK = ENDINGS[4:]
RECIPE = """
[views]
height = 96
width = 120
[tracking]
points = 20
[export]
graphs = ["light"]
"""
_OPERATIONS = ("open", "os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.truncate", "shutil.rmtree")


@dataclass(frozen=True)
class Command:
    """A command that is run in a folder: the outputs that it makes there, its inputs, and whether an output is
    whole.
    """

    arguments: tuple[str, ...]
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    whole: Callable[[Path, Path], bool]  # of an output and that of the reference run
    replaces: bool  # whether it replaces older outputs


def _same_result(path: Path, reference: Path) -> bool:
    return results.load_result(path).equals(_reference_result(reference))


@functools.cache
def _reference_result(path: Path) -> xr.Dataset:
    """Return the reference result, loaded once because loading takes as long as the command."""
    return results.load_result(path)


def _same_pictures(path: Path, reference: Path) -> bool:
    if path.suffix == ".html":
        return is_marked(path) and path.read_text(encoding="utf-8").rstrip().endswith("</html>")
    if path.suffix == ".png":
        return np.array_equal(cv2.imread(str(path)), cv2.imread(str(reference)))
    return is_marked(path) and _frames(path) == _frames(reference) > 0


def _frames(path: Path) -> int:
    video, count = cv2.VideoCapture(str(path)), 0
    while video.read()[0]:
        count += 1
    return count


def _same_files(path: Path, reference: Path) -> bool:
    ours, theirs = (
        {str(one.relative_to(folder)): one.read_bytes() for one in folder.rglob("*") if one.is_file()}
        for folder in (path, reference)
    )
    return ours == theirs


def _same_bundle(path: Path, reference: Path) -> bool:
    ours, theirs = ({one.relative_to(folder) for one in folder.rglob("*")} for folder in (path, reference))
    graphs = json.loads((path / "bundle.json").read_text())["graphs"]
    return ours == theirs and {(path / one["file"]).exists() for one in graphs.values()} == {True}


def _readable_stream(path: Path, reference: Path) -> bool:
    """Return whether the results of a stream can be read and hold its frames from the first one on."""
    frames = open_stream(path).load()["frame"].values
    return np.array_equal(frames, np.arange(len(frames))) and len(frames) <= open_stream(reference).sizes["frame"]


COMMANDS = {
    "process": Command(
        ("process", "press/scene.toml", "--output", "result.h5"), ("result.h5",), ("press",), _same_result, True,
    ),
    "report": Command(
        ("report", "press/scene.toml", "--result", "given.h5"),
        ("press/report.html", "press/overlay.mp4"), ("press", "given.h5"), _same_pictures, True,
    ),
    "simulate": Command(("simulate", "press", "made"), ("made",), (), _same_files, False),
    "export": Command(("export", "recipe.toml", "--output", "bundle"), ("bundle",), ("recipe.toml",), _same_bundle,
                      False),
    "stream": Command(
        ("stream", "tiny", "--source", "synthetic", "--frames", "200", "--page", "off", "--output", "played",
         "--threads", "1"),
        ("played",), ("tiny",), _readable_stream, False,
    ),
}  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.kills", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=100, help="runs (100)")
    parser.add_argument("--seed", type=int, default=16)
    parser.add_argument("--command", choices=COMMANDS, action="append", help="only this one; may be repeated")
    asked = parser.parse_args(arguments)
    rng = random.Random(asked.seed)
    _make_small()
    counts: Counter[tuple[str, str]] = Counter()
    faults: list[str] = []
    with disk_in_memory() as (disk, mounted):
        base = disk.parent / "base"
        endings = [one for one in ENDINGS if mounted or one not in ON_A_DISK]
        if not mounted:
            print(f"no file system can be mounted here: without {', '.join(ON_A_DISK)}")
        names = asked.command or list(COMMANDS)
        costs = _references(base, names)
        for number in range(asked.count):
            # Combine each command with each ending in turn.
            turn, which = divmod(number, len(names))
            name, ending = names[which], endings[(turn + which) % len(endings)]
            said = _run(COMMANDS[name], base, disk, ending, rng, *costs[name])
            counts[name, ending] += 1
            for fault in said:
                faults.append(f"{number} {name}, {ending}: {fault}")
                print(faults[-1], flush=True)
            if (number + 1) % 10 == 0:
                print(f"{number + 1} runs, {len(faults)} faults", flush=True)
    print(f"{'':10}" + "".join(f"{ending:>16}" for ending in endings))
    for name in names:
        print(f"{name:10}" + "".join(f"{counts[name, ending]:16}" for ending in endings))
    print(f"{asked.count} runs, {len(faults)} faults")
    return 1 if faults else 0


def _make_small() -> None:
    """Make scenes, figures and graphs so small that each takes a second or two of a processor."""
    from fingerflow import synthetic

    press = replace(TINY_PRESS, n_frames=24, frame_rate=24.0)
    synthetic.Press = lambda: press  # type: ignore[misc, assignment]
    patient_file._PATIENCE = 1.0  # s, instead of half a minute
    write_bundle.verify = lambda *_: []  # type: ignore[attr-defined]  # tested by tests/export
    _ = playing, reporting, load_scene, load_bundle  # load these modules once, here


@contextlib.contextmanager
def disk_in_memory() -> Iterator[tuple[Path, bool]]:
    """Yield a folder, and whether a small file system could be mounted there."""
    top = Path(tempfile.mkdtemp(prefix="kills-"))
    disk = top / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(disk)]
    mounted = os.name == "posix" and subprocess.run(mount, capture_output=True, check=False).returncode == 0
    try:
        yield disk, mounted
    finally:
        if mounted:
            subprocess.run(["umount", str(disk)], check=True)
        shutil.rmtree(top, ignore_errors=True)


def _references(base: Path, names: list[str]) -> dict[str, tuple[float, int]]:
    """Make the inputs and outputs of runs that are not ended; return the processor time (s) and the number of file
    operations of each command.
    """
    (base / "given").mkdir(parents=True)
    (base / "given" / "recipe.toml").write_text(RECIPE)
    tiny_bundle.write_bundle(base / "given" / "tiny")
    told = base / "told"
    for arguments in (("simulate", "press", "press"), ("process", "press/scene.toml", "--output", "given.h5")):
        assert _fork(arguments, base / "given", told)[0] == 0, told.read_text()
    costs = {}
    for name in names:
        folder = base / name
        for _ in range(2):  # the second run finds all modules imported
            shutil.rmtree(folder, ignore_errors=True)
            _fill(folder, COMMANDS[name], base)
            status, cost = _fork(COMMANDS[name].arguments, folder, told)
        assert status == 0, told.read_text()
        costs[name] = cost
        print(f"{name}: {cost[0]:.1f} s of a processor, {cost[1]} files opened, renamed, made or removed", flush=True)
    return costs


def _fill(folder: Path, command: Command, base: Path) -> None:
    folder.mkdir()
    for name in command.inputs:
        given = base / "given" / name
        shutil.copytree(given, folder / name) if given.is_dir() else shutil.copy(given, folder / name)


def _run(
    command: Command, base: Path, disk: Path, ending: str, rng: random.Random, seconds: float, operations: int
) -> list[str]:
    """Run a command once and end it; return its faults, a sentence each."""
    folder, told, ballast = disk / "run", disk.parent / "told", disk / "ballast"
    reference = base / command.arguments[0]
    shutil.rmtree(folder, ignore_errors=True)
    _fill(folder, command, base)
    older = command.replaces and rng.random() < 0.5
    for name in command.outputs if older else ():
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(reference / name, folder / name)
    before = _names(folder)
    at = rng.random()
    moment: dict[str, float] = {}
    if ending == "kill at a file":
        moment["operation"] = int(at * operations)
    elif ending in ("kill", "SIGTERM", "SIGINT"):
        moment["seconds"] = max(1e-3, at * seconds)
    elif ending in ("full disk", "freed disk"):
        wanted = sum(one.stat().st_size for one in reference.rglob("*") if one.is_file())
        free = int(at * 1.2 * wanted) + (KEPT_FREE if rng.random() < 0.7 else 0)
        leave_free(ballast, free)
        if ending == "freed disk":
            moment["operation"] = int(rng.random() * operations)
    else:
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    status, _ = _fork(command.arguments, folder, told, ending, moment, ballast)
    said = told.read_text(errors="replace")
    faults = []
    if ending == "read-only":
        subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True)
    ballast.unlink(missing_ok=True)
    for name in command.outputs:
        state = _state(command, folder / name, reference / name)
        if state == "absent" and older:
            faults.append(f"{name} was finished before, and is gone")
        elif state not in ("absent", "whole"):
            faults.append(f"{name} {state}")
    if "Traceback" in said:
        faults.append(f"traceback: {said[said.index('Traceback') :]}")
    allowed = {
        "kill": (0, -signal.SIGPROF), "kill at a file": (0, -signal.SIGKILL), "SIGTERM": (0, -signal.SIGTERM, 143),
        "SIGINT": (0, 130, -signal.SIGINT), "read-only": (2,),
    }.get(ending, (0, 2))  # fmt: skip
    if status not in allowed:
        faults.append(f"ended with {status}: {said[-300:]}")
    if status in (0, 2, 130):  # the command had the time to clear up
        faults += _left_behind(folder, before, command)
    again, _ = _fork(command.arguments, folder, told)
    said = told.read_text(errors="replace")
    if again != 0 and not (again == 2 and not command.replaces and "exist" in said):
        faults.append(f"the next run ended with {again}: {said[-300:]}")
    for name in command.outputs:
        state = _state(command, folder / name, reference / name)
        if state != "whole":
            faults.append(f"after the next run {name} is {state}")
    return faults + [f"after the next run: {one}" for one in _left_behind(folder, before, command)]


def leave_free(ballast: Path, free: int) -> None:
    """Make the file `ballast` so large that its disk has `free` bytes left, while others may write to the disk."""
    ballast.unlink(missing_ok=True)
    with ballast.open("wb") as file:
        while (more := shutil.disk_usage(ballast.parent).free - free) > 0:
            try:
                os.posix_fallocate(file.fileno(), 0, more)
            except OSError as error:
                if error.errno != errno.ENOSPC:
                    raise
            else:
                return


def _state(command: Command, path: Path, reference: Path) -> str:
    if not path.exists():
        return "absent"
    try:
        return "whole" if command.whole(path, reference) else "is there and not whole"
    except (FingerflowError, OSError, ValueError, KeyError) as error:
        return f"is there and cannot be read: {error}"


def _names(folder: Path) -> set[str]:
    return {str(one.relative_to(folder)) for one in folder.rglob("*")}


def _left_behind(folder: Path, before: set[str], command: Command) -> list[str]:
    whole = {*command.outputs, *(str(Path(one).parent) for one in command.outputs)}
    more = [name for name in sorted(_names(folder) - before) if name not in whole]
    more = [name for name in more if not any(name.startswith(f"{one}/") for one in command.outputs)]
    return [f"left behind: {', '.join(more)}"] if more else []


def _fork(
    arguments: tuple[str, ...], folder: Path, told: Path, ending: str = "", moment: dict[str, float] | None = None,
    ballast: Path | None = None,
) -> tuple[int, tuple[float, int]]:  # fmt: skip
    """Run a command in a process of its own; return its status, and its processor time (s) and number of file
    operations.
    """
    reading, writing = os.pipe()
    sys.stdout.flush()
    process = os.fork()
    if not process:
        os.close(reading)
        _become(arguments, folder, told, ending, moment or {}, ballast, writing)
    os.close(writing)
    with IdleLimit(process, 60.0), os.fdopen(reading, "rb") as answer:
        cost = answer.read()
        status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    seconds, operations, modules = json.loads(cost) if cost else (0.0, 0, [])
    for module in modules:  # imported once here instead of in each process
        with contextlib.suppress(Exception):
            importlib.import_module(module)
    return status, (seconds, operations)


def _become(
    arguments: tuple[str, ...], folder: Path, told: Path, ending: str, moment: dict[str, float],
    ballast: Path | None, answer: int,
) -> None:  # fmt: skip
    """Run the command in the new process, until it ends or is ended."""
    status, begun, operations, known = 1, os.times(), 0, set(sys.modules)

    def count(event: str, values: tuple[object, ...]) -> None:
        nonlocal operations
        if event not in _OPERATIONS or (event == "open" and not int(values[2]) & (os.O_WRONLY | os.O_RDWR)):  # type: ignore[call-overload]
            return
        if operations == moment.get("operation"):
            operations += 1  # the next operations are not those of the command
            if ending == "kill at a file":
                os.kill(os.getpid(), signal.SIGKILL)
            elif ballast is not None:
                ballast.unlink(missing_ok=True)
        operations += 1

    try:
        out = os.open(told, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(out, 1)
        os.dup2(out, 2)
        os.chdir(folder)
        sys.argv = ["fingerflow", *arguments]
        if "seconds" in moment:
            if ending != "kill":
                number = getattr(signal, ending)
                signal.signal(signal.SIGPROF, lambda *_: os.kill(os.getpid(), number))
            signal.setitimer(signal.ITIMER_PROF, moment["seconds"])
        sys.addaudithook(count)
        cli.main()
    except SystemExit as error:
        status = error.code if isinstance(error.code, int) else 1
    except BaseException:
        traceback.print_exc()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        sys.stdout.flush()
        sys.stderr.flush()
        now = os.times()
        modules = [name for name in sys.modules if name not in known and not name.startswith("__")]
        with os.fdopen(answer, "w") as writing:
            json.dump((now.user + now.system - begun.user - begun.system, operations, modules), writing)
        os._exit(status)


if __name__ == "__main__":
    sys.exit(main())
