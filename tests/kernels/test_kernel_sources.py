"""Tests of the C++ sources by themselves: sanitizers find no fault, and the package builds without a compiler."""

import importlib.util
import os
import runpy
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

HERE = Path(__file__).parent
ROOT = HERE.resolve().parents[1]

ISA = "-DFINGERFLOW_ISA=baseline"  # namespace of sources compiled for each instruction set
SANITIZERS = {"memory": "address,undefined", "threads": "thread"}


def compiler_of(flags: tuple[str, ...], folder: Path) -> tuple[str, ...]:
    """Return the command that compiles with a sanitizer; skip the test if there is none."""
    compiler = shutil.which(os.environ.get("CXX", "g++"))
    if compiler is None:
        pytest.skip("no C++ compiler here")
    command = (compiler, "-std=c++17", "-fno-sanitize-recover=all", "-pthread", *flags)
    empty, program = folder / "empty.cpp", folder / "empty"
    empty.write_text("int main() {}\n")
    if subprocess.run([*command, str(empty), "-o", str(program)], capture_output=True).returncode:
        pytest.skip("this compiler has no such sanitizer")
    if subprocess.run([str(program)], capture_output=True).returncode:
        pytest.skip("this system does not run programs with such a sanitizer")
    includes = [f"-I{place}" for place in (ROOT / "kernels", ROOT / "fingerflow" / "kernels", folder)]
    return (*command, *includes)


def compiled(sources: Sequence[Path], command: tuple[str, ...], folder: Path) -> list[str]:
    """Compile the sources in a new folder; return the paths of the objects."""
    folder.mkdir()
    subprocess.run([*command, "-c", *map(str, sources)], cwd=folder, check=True)
    return sorted(map(str, folder.glob("*.o")))


def run(program: Path) -> None:
    """Run a program and assert that it has no failures.

    The thread sanitizer must not end the program for threads of a forked child, which the program tests.
    """
    environment = {**os.environ, "TSAN_OPTIONS": "die_after_fork=0"}
    ran = subprocess.run([str(program)], capture_output=True, text=True, timeout=300, env=environment)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert ran.stdout == "0 failures\n"


def kernel_sources(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the sources that are compiled for each instruction set, and all others with the generated source and the
    program.
    """
    for path in (ROOT / "kernels").glob("generate_*.py"):
        generator = runpy.run_path(str(path))
        (folder / generator["GENERATES"]).write_text(generator["source"](), encoding="utf-8")
    sources = sorted((ROOT / "kernels").glob("*.cpp"))
    hot = [one for one in sources if "FINGERFLOW_ISA" in one.read_text(encoding="utf-8")]
    return hot, [*(one for one in sources if one not in hot), folder / "entries.cpp", HERE / "sanitized.cpp"]


def test_sanitizers_find_no_wrong_access(tmp_path: Path) -> None:
    """The address sanitizer finds no access outside the images, whose memory ends right behind them, for the baseline
    and for the widest vectors of this processor.
    """
    hot, plain = kernel_sources(tmp_path)
    command = compiler_of(("-O0", f"-fsanitize={SANITIZERS['memory']}"), tmp_path)
    of_all = compiled(plain, command, tmp_path / "plain")
    for name, more in {"baseline": (), "native": ("-march=native",)}.items():
        objects = compiled(hot, (*command, ISA, *more), tmp_path / name)
        subprocess.run([*command, *of_all, *objects, "-o", str(tmp_path / "sanitized")], check=True)
        run(tmp_path / "sanitized")


def test_sanitizer_finds_no_race(tmp_path: Path) -> None:
    sources = [one for part in kernel_sources(tmp_path) for one in part]
    command = compiler_of(("-O0", f"-fsanitize={SANITIZERS['threads']}"), tmp_path)
    subprocess.run([*command, ISA, *map(str, sources), "-o", str(tmp_path / "sanitized")], check=True)
    run(tmp_path / "sanitized")


@pytest.mark.parametrize("sanitizer", SANITIZERS)
def test_pool_of_threads(sanitizer: str, tmp_path: Path) -> None:
    """The pool of threads has no race and no wrong access with faults in any piece of any thread, parallel callers,
    nested calls and forks.
    """
    command = compiler_of(("-O1", f"-fsanitize={SANITIZERS[sanitizer]}"), tmp_path)
    sources = (ROOT / "kernels" / "parallel.cpp", HERE / "pool.cpp")
    subprocess.run([*command, *map(str, sources), "-o", str(tmp_path / "pool")], check=True)
    run(tmp_path / "pool")


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
