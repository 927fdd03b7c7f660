"""Check, run by cibuildwheel in an empty environment, that a wheel has the kernels and that both forms agree."""

from pathlib import Path

import torch

import fingerflow
from fingerflow import ops
from fingerflow.kernels import tensors as kernels


def main() -> None:
    if (Path(fingerflow.__file__).parents[1] / "setup.py").exists():
        raise SystemExit("fingerflow is the source tree here, not the wheel")
    frames = torch.randint(0, 256, (2, 1, 64, 80), generator=torch.Generator().manual_seed(0), dtype=torch.uint8)
    if not kernels.serve(frames):
        raise SystemExit("the compiled kernels are not in this wheel, or this processor cannot run them")
    compiled = ops.median_filter(frames, 9)
    kernels.serve = lambda *tensors: False
    if not torch.equal(compiled, ops.median_filter(frames, 9)):
        raise SystemExit("the compiled median is not the portable one")
    print("kernels: there, and equal to the portable form")


if __name__ == "__main__":
    main()
