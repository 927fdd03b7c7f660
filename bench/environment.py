"""Description of the machine, library versions and threads with which a benchmark ran."""

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import distributions
from pathlib import Path

import cv2
import torch

from fingerflow.kernels import tensors as kernels

_PACKAGES = (
    "fingerflow-engine",
    "torch",
    "onnxruntime",
    "opencv-contrib-python-headless",
    "numpy",
    "scipy",
    "scikit-image",
    "kornia",
)


def share_cores() -> None:
    """Give OpenCV as many threads as torch has."""
    cv2.setNumThreads(torch.get_num_threads())


@contextmanager
def one_thread() -> Iterator[None]:
    """Context in which torch, and with it fingerflow, computes with one thread."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def describe() -> dict[str, dict[str, str | int | None]]:
    """Return machine, versions and threads of a run, and whether the compiled kernels are in use."""
    installed = {name: next((one.version for one in distributions(name=name)), None) for name in _PACKAGES}
    return {
        "machine": {"cpu": _processor(), "cores": os.cpu_count(), "system": platform.system()},
        "versions": {"python": platform.python_version(), **installed},
        "threads": {
            "torch": torch.get_num_threads(),
            "opencv": cv2.getNumThreads(),
            "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS"),
        },
        "kernels": {"compiled": kernels.serve()},
    }


def _processor() -> str:
    """Return the model name of the processor: on Linux from /proc/cpuinfo, which `platform` does not read."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
