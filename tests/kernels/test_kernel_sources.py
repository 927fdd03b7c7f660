"""The C++ by itself: clean under sanitizers, and dispensable where there is no compiler."""

import importlib.util
import os
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ROOT = HERE.resolve().parents[1]


GENERATED = (
    ("generate_median", "median_networks.h"),
    ("generate_limits", "tracking_limits.h"),
    ("generate_entries", "entries.cpp"),
)
SANITIZERS = {"memory": "address,undefined", "threads": "thread"}


def build(program: Path, *sources: Path, flags: tuple[str, ...]) -> None:
    """A program with a sanitizer, of these sources and what they include; skips the test where that cannot be had."""
    compiler = shutil.which(os.environ.get("CXX", "g++"))
    if compiler is None:
        pytest.skip("no C++ compiler here")
    flags = ("-std=c++17", "-fno-sanitize-recover=all", "-pthread", *flags)
    empty = program.with_name("empty.cpp")
    empty.write_text("int main() {}\n")
    if subprocess.run([compiler, *flags, str(empty), "-o", str(program)], capture_output=True).returncode:
        pytest.skip("this compiler has no such sanitizer")
    if subprocess.run([str(program)], capture_output=True).returncode:
        pytest.skip("this system does not run programs with such a sanitizer")
    includes = [f"-I{folder}" for folder in (ROOT / "kernels", ROOT / "fingerflow" / "kernels", program.parent)]
    command = [compiler, *flags, "-DFINGERFLOW_ISA=baseline", *includes, *map(str, sources), "-o", str(program)]
    subprocess.run(command, check=True)


def run(program: Path) -> None:
    """Threads of a child after a fork are what is tried: the sanitizer must not end it for them."""
    environment = {**os.environ, "TSAN_OPTIONS": "die_after_fork=0"}
    ran = subprocess.run([str(program)], capture_output=True, text=True, timeout=300, env=environment)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert ran.stdout == "0 failures\n"


@pytest.mark.parametrize(
    "flags",
    [
        ("-fsanitize=address,undefined",),
        ("-fsanitize=address,undefined", "-march=native"),
        ("-fsanitize=thread",),
    ],
    ids=["baseline", "native", "threads"],
)
def test_sanitizers_find_nothing(flags: tuple[str, ...], tmp_path: Path) -> None:
    """Memory of the images ends right behind them, so that any read or write beyond an edge is seen.

    For the baseline, with vectors as wide as this processor has them, and for races between threads.
    """
    for stem, generated in GENERATED:
        runpy.run_path(str(ROOT / "kernels" / f"{stem}.py"))["main"](str(tmp_path / generated))
    sources = [*sorted((ROOT / "kernels").glob("*.cpp")), tmp_path / "entries.cpp", HERE / "sanitized.cpp"]
    build(tmp_path / "sanitized", *sources, flags=("-O0", *flags))
    run(tmp_path / "sanitized")


@pytest.mark.parametrize("sanitizer", SANITIZERS)
def test_pool_of_threads(sanitizer: str, tmp_path: Path) -> None:
    """Faults in any piece of any thread, callers side by side, calls within calls, forks."""
    flags = ("-O1", f"-fsanitize={SANITIZERS[sanitizer]}")
    build(tmp_path / "pool", ROOT / "kernels" / "parallel.cpp", HERE / "pool.cpp", flags=flags)
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
