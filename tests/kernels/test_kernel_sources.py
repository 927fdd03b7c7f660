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

SANITIZERS = {"memory": ("address,undefined", "asan", "ubsan"), "threads": ("thread", "tsan")}


def compile_sanitized(sanitizer: str, options: Iterable[str], sources: Iterable[Path], program: Path) -> list[str]:
    """Compile sources with a sanitizer into `program`, and return the libraries of that sanitizer; skip without it."""
    compiler = shutil.which(os.environ.get("CXX", "g++"))
    if compiler is None:
        pytest.skip("no C++ compiler here")
    kinds, *libraries = SANITIZERS[sanitizer]
    command = [compiler, "-std=c++17", f"-fsanitize={kinds}", "-fno-sanitize-recover=all", "-pthread"]
    empty = program.with_name("empty.cpp")
    empty.write_text("int main() {}\n")
    for attempt in ([*command, str(empty), "-o", str(program)], [str(program)]):
        if subprocess.run(attempt, capture_output=True).returncode:
            pytest.skip("this compiler or system has no such sanitizer")
    includes = [f"-I{folder}" for folder in (ROOT / "kernels", program.parent)]
    subprocess.run([*command, *options, *includes, *map(str, sources), "-o", str(program)], check=True)
    named = ([compiler, f"-print-file-name=lib{name}.so"] for name in libraries)
    return [subprocess.run(line, capture_output=True, text=True).stdout.strip() for line in named]


def run_sanitized(command: list[str], **environment: str) -> str:
    """Run a program and return its output; assert that the sanitizer reports nothing.

    The thread sanitizer must not end the program for threads of a forked child. Modules that it did not compile, such
    as torch with its OpenMP, are not looked at. Python leaks on purpose.
    """
    options = {"TSAN_OPTIONS": "die_after_fork=0 ignore_noninstrumented_modules=1", "ASAN_OPTIONS": "detect_leaks=0"}
    variables = {**os.environ, **options, **environment}
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600, env=variables)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


@pytest.mark.parametrize("sanitizer", SANITIZERS)
def test_sanitizers_find_no_wrong_access_and_no_race(sanitizer: str, tmp_path: Path) -> None:
    """There is no access outside the arrays, with the widest vectors of this processor, which reach furthest; no
    undefined behaviour; and no race of threads.
    """
    for path in (ROOT / "kernels").glob("generate_*.py"):
        generator = runpy.run_path(str(path))
        (tmp_path / generator["GENERATES"]).write_text(generator["source"](), encoding="utf-8")
    sources = [*(ROOT / "kernels").glob("*.cpp"), tmp_path / "entries.cpp"]
    widest = ("-march=native",) if sanitizer == "memory" else ()
    options = ("-O0", "-DFINGERFLOW_ISA=baseline", *widest, "-shared", "-fPIC")
    library = tmp_path / "kernels.so"
    first = " ".join(compile_sanitized(sanitizer, options, sources, library))
    calls = "all" if sanitizer == "memory" else "last"
    command = [sys.executable, "-m", "tests.kernels.sanitized_calls", str(library), calls]
    assert run_sanitized(command, LD_PRELOAD=first, OMP_NUM_THREADS="1") == "not entered: []\n"


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
