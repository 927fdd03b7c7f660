"""Illumination gain of a frame relative to an image of the empty glass, measured where no finger covers the glass.

The uppermost mode is found by mean shift (Fukunaga & Hostetler 1975). Compiled twin: `kernels/illumination_gain.cpp`.
"""

import torch
from torch import Tensor

from fingerflow.kernels import contact_sizes as sizes
from fingerflow.kernels.contact_sizes import block_of
from fingerflow.kernels.tensors import Twin, twin
from fingerflow.ops.tensors import finite

_compiled: Twin[Tensor] = twin("illumination_gain")


def illumination_gain(frames: Tensor, light: Tensor, black: Tensor, radius: int = 8) -> Tensor:
    """Return the illumination gain (B,) of each frame: the ratio of its light to the light of the empty glass, measured
    on blocks of pixels where no skin touches the glass.

    The gain is NaN if no glass is visible. A block is wide enough to hold a ridge and the skin beside it. In every
    block skin is therefore darker than glass and has a larger variance. A mean shift that starts from the brightest of
    the smooth blocks finds the uppermost mode of their quotients. That mode is glass if it is narrow. One gain per
    frame describes a change of the lamp, the exposure or the camera gain, but not a shadow.

    Every fourth line is read. With 1 % of noise per pixel a block of 16 px has 0.13 %, and a frame has hundreds of
    blocks.

    Args:
        frames: (B, 1, H, W), integers of 8 to 16 bit or floating, camera counts; non-finite pixels do not count.
        light, black: (1 or B, 1, H, W) of `ops.filters.illumination.glass_light`.
        radius: px, half the distance between ridges, or slightly more.

    Returns:
        (B,) in the dtype of `light`, between 0.7 and 1.4, else NaN: a larger change of light cannot be distinguished
        from a frame full of contact.
    """
    dtype = light.dtype
    block = block_of(radius)
    if _compiled.serves(frames, light, black):
        return _compiled(frames, light, black, block)
    lines, empty, dark = (image[..., sizes.LINE_STEP // 2 :: sizes.LINE_STEP, :] for image in (frames, light, black))
    if lines.shape[2] < block // sizes.LINE_STEP or lines.shape[3] < block:
        return torch.full(frames.shape[:1], torch.nan, dtype=dtype, device=light.device)
    if frames.is_floating_point():
        lines, empty = (torch.where(finite(lines), image, 0.0) for image in (lines, empty))
    passed = (lines.to(dtype) - dark) * (empty > 0).to(dtype)
    return _uppermost_mode(*_blocks(passed, block), *_blocks(empty, block))


def _blocks(lines: Tensor, block: int) -> list[Tensor]:
    """Return, for each of N square blocks of a frame, `block` px wide, the sum of the pixel values and the sum of their
    squares, (B, N) each.

    `lines` (B, 1, h, W) are every fourth line of the frame.
    """
    height, width = lines.shape[-2:]
    rows = block // sizes.LINE_STEP
    cut = lines[..., : height // rows * rows, : width // block * block]
    blocks = (values.unflatten(2, (-1, rows)).sum(3).unflatten(3, (-1, block)) for values in (cut, cut * cut))
    return [values.sum(4).flatten(1) for values in blocks]


def _uppermost_mode(passed: Tensor, passed_squared: Tensor, light: Tensor, light_squared: Tensor) -> Tensor:
    lit = light > sizes.LIT * light.amax(1, keepdim=True)
    quotient = torch.where(lit, passed / torch.where(lit, light, 1.0), 0.0)
    variance = passed_squared / torch.where(lit, light_squared, 1.0) - quotient * quotient
    quotient = torch.where(variance < sizes.ROUGH**2, quotient, 0.0)
    number = lit.to(quotient.dtype).sum(1, keepdim=True)
    # Start from the least of the brightest 3 % of the blocks: reflections lie above it.
    gain = quotient.topk(max(1, round(sizes.TOP * quotient.shape[1])), dim=1).values[:, -1:]
    for width in sizes.WIDTHS:
        near = ((quotient - gain).abs() <= width * gain).to(quotient.dtype)
        gain = (quotient * near).sum(1, keepdim=True) / near.sum(1, keepdim=True).clamp_min(1)
    distance = quotient / gain.clamp_min(1e-6) - 1
    glass = ((distance.abs() <= sizes.NARROW_GLASS) & lit).to(quotient.dtype).sum(1, keepdim=True)
    lower = (
        ((distance < -sizes.NARROW_GLASS) & (distance >= -sizes.BESIDE_GLASS)).to(quotient.dtype).sum(1, keepdim=True)
    )
    seen = (gain > sizes.LEAST_GAIN) & (gain < sizes.MOST_GAIN) & (glass >= sizes.TOP * number) & (glass >= 2 * lower)
    return torch.where(seen, gain, torch.nan).squeeze(1)
