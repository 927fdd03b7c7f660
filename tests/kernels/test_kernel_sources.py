"""Tests of the C++ sources by themselves: sanitizers find no fault, and the package builds without a compiler."""

import importlib.util
import os
import runpy
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

HERE = Path(__file__).parent
ROOT = HERE.resolve().parents[1]

SANITIZERS = {"memory": "address,undefined", "threads": "thread"}


def run_sanitized(sanitizer: str, flags: tuple[str, ...], sources: Iterable[Path], folder: Path) -> None:
    """Compile a program with a sanitizer, run it and assert that it has no failures; skip without the sanitizer.

    The thread sanitizer must not end the program for threads of a forked child, which the program tests.
    """
    compiler = shutil.which(os.environ.get("CXX", "g++"))
    if compiler is None:
        pytest.skip("no C++ compiler here")
    flags = (f"-fsanitize={SANITIZERS[sanitizer]}", "-fno-sanitize-recover=all", "-pthread", *flags)
    command = [compiler, "-std=c++17", *flags, "-o", str(folder / "program")]
    program, empty = str(folder / "program"), folder / "empty.cpp"
    empty.write_text("int main() {}\n")
    for attempt in ([*command, str(empty)], [program]):
        if subprocess.run(attempt, capture_output=True).returncode:
            pytest.skip("this compiler or system has no such sanitizer")
    includes = [f"-I{place}" for place in (ROOT / "kernels", ROOT / "fingerflow" / "kernels", folder)]
    subprocess.run([*command, *includes, *map(str, sources)], check=True)
    environment = {**os.environ, "TSAN_OPTIONS": "die_after_fork=0"}
    ran = subprocess.run([program], capture_output=True, text=True, timeout=300, env=environment)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert ran.stdout == "0 failures\n"


@pytest.mark.parametrize("sanitizer", SANITIZERS)
def test_sanitizers_find_no_wrong_access_and_no_race(sanitizer: str, tmp_path: Path) -> None:
    """There is no access outside the images, whose memory ends right behind them, with the widest vectors of this
    processor, which reach furthest; and no race of threads.
    """
    for path in (ROOT / "kernels").glob("generate_*.py"):
        generator = runpy.run_path(str(path))
        (tmp_path / generator["GENERATES"]).write_text(generator["source"](), encoding="utf-8")
    sources = [*(ROOT / "kernels").glob("*.cpp"), tmp_path / "entries.cpp", HERE / "sanitized.cpp"]
    widest = ("-march=native",) if sanitizer == "memory" else ()
    run_sanitized(sanitizer, ("-O0", "-DFINGERFLOW_ISA=baseline", *widest), sources, tmp_path)


@pytest.mark.parametrize("sanitizer", SANITIZERS)
def test_pool_of_threads(sanitizer: str, tmp_path: Path) -> None:
    """The pool of threads has no race and no wrong access with faults in any piece of any thread, parallel callers,
    nested calls and forks.
    """
    run_sanitized(sanitizer, ("-O1",), (ROOT / "kernels" / "parallel.cpp", HERE / "pool.cpp"), tmp_path)


@pytest.mark.skipif(importlib.util.find_spec("setuptools") is None, reason="setuptools is not installed")
def test_builds_nothing_but_succeeds_without_a_compiler(tmp_path: Path) -> None:
    none = shutil.which("false")
    if none is None:
        pytest.skip("there is no command here that fails")
    command = [sys.executable, "setup.py", "build_ext", f"--build-temp={tmp_path}", f"--build-lib={tmp_path / 'lib'}"]
    environment = {**os.environ, "CC": none, "CXX": none}
    ran = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert 'building extension "fingerflow._kernels" failed' in ran.stdout + ran.stderr
    assert not list(tmp_path.glob("lib/**/*_kernels*"))
