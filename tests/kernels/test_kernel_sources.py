"""The C++ by itself: clean under sanitizers, and dispensable where there is no compiler."""

import importlib.util
import os
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("widest", [[], ["-march=native"]], ids=["baseline", "native"])
def test_sanitizers_find_nothing(widest: list[str], tmp_path: Path) -> None:
    """Memory of the images ends right behind them, so that any read or write beyond an edge is seen.

    For the baseline, and with vectors as wide as this processor has them.
    """
    compiler = shutil.which(os.environ.get("CXX", "g++"))
    if compiler is None:
        pytest.skip("no C++ compiler here")
    for stem, header in (("generate_median", "median_networks.h"), ("generate_limits", "tracking_limits.h")):
        runpy.run_path(str(ROOT / "kernels" / f"{stem}.py"))["main"](str(tmp_path / header))
    flags = [
        "-std=c++17",
        "-O0",
        "-fsanitize=address,undefined",
        "-fno-sanitize-recover=undefined",
        "-pthread",
        *widest,
    ]
    includes = ["-DFINGERFLOW_ISA=baseline", f"-I{ROOT / 'kernels'}", f"-I{tmp_path}"]
    empty = tmp_path / "empty.cpp"
    empty.write_text("int main() {}\n")
    program = tmp_path / "sanitized"
    if subprocess.run([compiler, *flags, str(empty), "-o", str(program)], capture_output=True).returncode:
        pytest.skip("this compiler has no sanitizers")
    sources = [*map(str, sorted((ROOT / "kernels").glob("*.cpp"))), str(Path(__file__).with_name("sanitized.cpp"))]
    subprocess.run([compiler, *flags, *includes, *sources, "-o", str(program)], check=True)
    ran = subprocess.run([str(program)], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert ran.stdout == "0 failures\n"


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
