"""Images on which every compiled kernel is tested."""

import torch

SHAPES = [(0, 5, 6), (1, 1, 1), (1, 1, 130), (2, 130, 1), (1, 3, 2), (5, 37, 41), (1, 66, 129), (2, 33, 800)]
CONTENTS = ["constant", "ramp", "two levels", "random"]


def images(
    shape: tuple[int, int, int], dtype: torch.dtype, content: str, seed: int = 0, highest: int | None = None
) -> torch.Tensor:
    """Return images (B, 1, H, W) of a dtype and content: "constant", "ramp", "two levels" or "random"."""
    batch, height, width = shape
    if highest is None:
        highest = 250 if dtype.is_floating_point else min(torch.iinfo(dtype).max, 65535)
    if content == "constant":
        values = torch.full((batch, 1, height, width), highest, dtype=torch.int32)
    elif content == "ramp":
        values = torch.arange(batch * height * width, dtype=torch.int32).reshape(batch, 1, height, width) * 7
        values = values % (highest + 1)
    else:
        levels = 2 if content == "two levels" else highest + 1
        generator = torch.Generator().manual_seed(seed + height * 1000 + width)
        values = torch.randint(0, levels, (batch, 1, height, width), generator=generator, dtype=torch.int32)
        values = values * (highest // (levels - 1))
    return values.to(dtype)
