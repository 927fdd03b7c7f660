"""Device on which the tests run Triton kernels: a CUDA GPU where there is one, else a CPU with Triton's interpreter."""

from collections.abc import Callable

import torch

GPU_TILES = "tiles of a GPU"  # parameter of the fixture `tiles`: tiles stay as large as on a GPU
Fused = Callable[[], None]  # from its call on, the kernels of Triton are used
DEVICE = torch.device("cuda" if torch.cuda.is_available() else "cpu")
