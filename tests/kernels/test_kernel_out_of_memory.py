"""Test that a kernel whose request for memory is refused raises MemoryError, and works again with the same threads."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fingerflow.kernels import tensors as kernels

HERE = Path(__file__).parent

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off"),
    pytest.mark.skipif(sys.platform != "linux", reason="LD_PRELOAD and forks are Linux's"),
]


def test_every_request_of_every_kernel_refused(tmp_path: Path) -> None:
    compiler = shutil.which(os.environ.get("CXX", "g++"))
    if compiler is None:
        pytest.skip("no C++ compiler here")
    hooks = tmp_path / "failing_new.so"
    source = HERE / "failing_new.cpp"
    subprocess.run([compiler, "-std=c++17", "-O1", "-shared", "-fPIC", str(source), "-o", str(hooks)], check=True)
    ran = subprocess.run(
        [sys.executable, "-m", "tests.kernels.short_of_memory"],
        cwd=HERE.parents[1],
        env={**os.environ, "LD_PRELOAD": str(hooks)},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert ran.returncode == 0, ran.stderr
    first, *lines = ran.stdout.splitlines()
    assert first == "missing:", "give short_of_memory.py a call that reaches these kernels"
    outcomes = {}
    for line in lines:
        name, _, said = line.partition(": ")
        outcomes[name] = {word.partition(" ")[2] for word in said.split(", ")}
    assert len(outcomes) > 20
    for name, words in outcomes.items():
        assert words <= {"MemoryError", "fewer threads", "all granted"}, f"{name}: {words}\n{ran.stderr}"
    assert "fewer threads" in outcomes["flow_template"]  # called by itself, with work for several threads
    # Kernels that request threads only: Python gives them the memory of their results and sums.
    without = {name for name, words in outcomes.items() if "MemoryError" not in words}
    assert without <= {"covered"}
