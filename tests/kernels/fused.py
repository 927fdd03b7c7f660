"""Kernels of Triton in tests: on a GPU of CUDA where there is one, else in Triton's interpreter."""

from collections.abc import Callable

import torch

Fused = Callable[[], None]  # from its call on, the kernels of Triton are used
DEVICE = torch.device("cuda" if torch.cuda.is_available() else "cpu")
