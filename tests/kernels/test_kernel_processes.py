"""Tests of kernels in forked children and from several threads at once: results are right, and no call hangs."""

import subprocess
import sys
import textwrap

import pytest

from fingerflow.kernels import tensors as kernels

pytestmark = [pytest.mark.long, pytest.mark.skipif(not kernels.serve(), reason="no compiled kernels, or turned off")]

BEGIN = """
import os, signal, sys, threading
import torch
from fingerflow.kernels import tensors as kernels

def frames(seed=0, count=4):
    return torch.randint(0, 256, (count, 1, 120, 160), dtype=torch.uint8, generator=torch.Generator().manual_seed(seed))

torch.set_num_threads(3)
given = frames()
right = kernels.median(given, 9).numpy().tobytes()

def is_right():
    # Without an op of torch's own that would take several threads: those do not work in a forked child.
    return kernels.median(given, 9).numpy().tobytes() == right
"""


def run(program: str, timeout: float = 90) -> None:
    """Run a program after `BEGIN` in a process of its own, so that a hang is a failure."""
    code = BEGIN + textwrap.dedent(program) + '\nprint("right")\n'
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=timeout)
    assert ran.stdout == "right\n", ran.stdout + ran.stderr


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="no fork here")
def test_a_forked_child_calls_kernels() -> None:
    """A forked child, such as a worker of a data loader, computes right results, also if a thread of the parent held
    the lock of the pool, or a lock of its own, during the fork.
    """
    run("""
        stop = False
        def work():
            while not stop:
                kernels.median(given, 3)
        worker = threading.Thread(target=work)
        worker.start()
        for _ in range(20):
            child = os.fork()
            if child == 0:
                signal.alarm(30)
                os._exit(0 if is_right() else 1)
            assert os.waitpid(child, 0)[1] == 0
            assert is_right()
        stop = True
        worker.join()
    """)


def test_threads_get_the_results_of_their_own_frames() -> None:
    """Each of several threads gets the results of its own frames, and its own exception."""
    run("""
        wrong = []
        def work(seed):
            own = frames(seed, 3)
            torch.set_num_threads(1 + seed % 3)
            wanted = kernels.median(own, 9)
            points = torch.rand(1, 50, 2) * 100 + 10
            variance = torch.ones(3)
            templates = kernels.twin("prepare_templates")(own[:1], points, None, variance[:1], 11, 1, 0.0)
            found = kernels.find_templates(templates, own, points, None, None, 1, 0.0, 1.0, 0.5)
            for _ in range(60):
                if not torch.equal(kernels.median(own, 9), wanted):
                    wrong.append(seed)
                again = kernels.find_templates(templates, own, points, None, None, 1, 0.0, 1.0, 0.5)
                if not all(torch.equal(a.nan_to_num(-1), b.nan_to_num(-1)) for a, b in zip(found, again)):
                    wrong.append(seed)
                try:
                    kernels.median(own, 4)
                    wrong.append(seed)
                except ValueError:
                    pass
        threads = [threading.Thread(target=work, args=(seed,)) for seed in range(6)]
        for thread in threads: thread.start()
        for thread in threads: thread.join()
        assert not wrong, wrong
    """)
