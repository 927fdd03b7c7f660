"""Tests of kernels in forked children, in workers of data loaders, and from several threads at once: results are right,
and no call hangs.
"""

import subprocess
import sys
import textwrap

import pytest

from fingerflow.kernels import tensors as kernels

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off"),
]

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
@pytest.mark.parametrize("busy", [False, True], ids=["idle", "another thread at work"])
def test_a_forked_child_calls_kernels(busy: bool) -> None:
    """A forked child computes right results, also if a thread of the parent held the lock of the pool, or a lock of its
    own, during the fork.
    """
    run(f"""
        stop = False
        def work():
            while not stop:
                kernels.median(given, 3)
        worker = threading.Thread(target=work)
        if {busy}:
            worker.start()
        for _ in range(20):
            child = os.fork()
            if child == 0:
                signal.alarm(30)
                os._exit(0 if is_right() else 1)
            assert os.waitpid(child, 0)[1] == 0
            assert is_right()
        stop = True
        if {busy}:
            worker.join()
    """)


def test_a_fault_in_a_forked_child() -> None:
    run("""
        child = os.fork()
        if child == 0:
            signal.alarm(30)
            kernels.inject_fault(1)
            try:
                kernels.median(frames(), 9)
            except MemoryError:
                kernels.inject_fault(0)
                os._exit(0 if is_right() else 1)
            os._exit(2)
        assert os.waitpid(child, 0)[1] == 0
        assert is_right()
    """)


LOADED = """
import torch
from fingerflow.kernels import tensors as kernels
from fingerflow.ops import median_filter, track_points


class Medians(torch.utils.data.Dataset):
    def __len__(self):
        return 8

    def __getitem__(self, number):
        torch.set_num_threads(2)
        generator = torch.Generator().manual_seed(number)
        frame = torch.randint(0, 256, (1, 1, 120, 160), dtype=torch.uint8, generator=generator)
        assert kernels.serve(frame)
        points = torch.tensor([[[60.0, 70.0], [80.0, 50.0]]])
        tracks = track_points(frame, frame.roll(1, -1), points, window=11)
        return median_filter(frame, 9), tracks.points.nan_to_num(-1.0)


def main(method):
    data = Medians()
    own = [data[number] for number in range(8)]
    settings = dict(batch_size=None, num_workers=2, multiprocessing_context=method, timeout=60)
    loader = torch.utils.data.DataLoader(data, **settings)
    for loaded, wanted in zip(loader, own, strict=True):
        assert all(torch.equal(one, other) for one, other in zip(loaded, wanted, strict=True))
"""


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_kernels_run_in_workers_of_a_data_loader(method: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    if method == "fork" and not hasattr(__import__("os"), "fork"):
        pytest.skip("no fork here")
    folder = tmp_path_factory.mktemp("loaded")
    (folder / "loaded_medians.py").write_text(LOADED, encoding="utf-8")
    program = f"import sys; sys.path.insert(0, {str(folder)!r})\nimport loaded_medians\n"
    program += f"if __name__ == '__main__':\n    loaded_medians.main({method!r})\n    print('right')\n"
    (folder / "program.py").write_text(program, encoding="utf-8")
    command = [sys.executable, str(folder / "program.py")]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert ran.stdout == "right\n", ran.stdout + ran.stderr


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
            templates = kernels.prepare_templates(own[:1], points, None, variance[:1], 11, True, 0.0)
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
