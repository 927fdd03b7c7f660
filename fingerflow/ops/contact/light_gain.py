"""How bright the lamp is in a frame, from the empty glass that is still seen in it."""

import torch
from torch import Tensor

from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.contact_sizes import block_of

_STEP = 4  # px between the lines that are read
_MOST, _LEAST = 1.4, 0.7  # gains beyond which nothing tells light that has changed from glass that is covered
_LIT = 0.25  # least light of a block, of that of the brightest
_ROUGH = 0.15  # deviation of quotients within a block: of noise it is less, of ridges more
_TOP = 0.03  # share of the blocks that are glass at least
_WIDTHS = (0.04, 0.02, 0.01, 0.01)  # to both sides of the gain, of windows whose means lead to it
_NARROW, _BESIDE = 0.02, 0.06  # glass is all within the first; skin has as much between the two below


def light_gain(frames: Tensor, light: Tensor, black: Tensor, radius: int = 8) -> Tensor:
    """Light of the frame over light of the empty glass where no skin touches; NaN where no glass is seen.

    Blocks are so wide that skin is darker than glass in each of them, and rough: ridges beside what lies between them.
    The brightest of the smooth blocks lead to the uppermost mode of their quotients. It is glass if it is narrow. One
    gain a frame: of a lamp, a shutter or a gain of the camera, not of a shadow.

    Every fourth line is read: 0.13 % of noise for a block of 16 px where a pixel has 1 %, and some hundred blocks.

    Args:
        frames: (B, 1, H, W), integers of 8 to 16 bit or floating, camera counts; what is not finite does not count.
        light, black: (1 or B, 1, H, W) of `ops.glass_light`.
        radius: px, half the distance of ridges, or a little more.

    Returns:
        (B,) of the type of `light`, within 0.7 to 1.4, else NaN: light that has changed by more cannot be told from a
        frame full of contact.
    """
    kind = light.dtype
    block = block_of(radius)
    if (
        frames.dtype in kernels.FRAME_KINDS
        and light.dtype == black.dtype == torch.float32
        and kernels.serve(frames, light, black)
    ):
        return kernels.light_gain(frames, light, black, block)
    if min(frames.shape[2:]) < block:
        return torch.full(frames.shape[:1], torch.nan, dtype=kind, device=light.device)
    some, given, dark = (image[..., _STEP // 2 :: _STEP, :] for image in (frames, light, black))
    if frames.is_floating_point():
        finite = some.abs() < torch.inf
        some, given = torch.where(finite, some, 0.0), torch.where(finite, given, 0.0)
    lit = (given > 0).to(kind)
    passed = torch.addcmul(-dark * lit, some.to(kind), lit)
    return _uppermost_mode(_blocks(passed, block), _blocks(given, block))


def _blocks(lines: Tensor, block: int) -> Tensor:
    """(B, 2, N) sums over blocks, of every fourth line (B, 1, h, W) and of its squares."""
    result: Tensor = torch.cat([_sums(one, block) for one in (lines, lines * lines)], dim=1)
    return result


def _sums(lines: Tensor, block: int) -> Tensor:
    height, width = lines.shape[-2:]
    rows = block // _STEP
    cut = lines[..., : height // rows * rows, : width // block * block]
    down = cut.unflatten(2, (-1, rows)).sum(3)
    result: Tensor = down.unflatten(3, (-1, block)).sum(4).flatten(2)
    return result


def _uppermost_mode(passed_sums: Tensor, light_sums: Tensor) -> Tensor:
    (passed, passed_squared), (light, light_squared) = passed_sums.unbind(1), light_sums.unbind(1)
    lit = light > _LIT * light.amax(1, keepdim=True)
    quotient = torch.where(lit, passed / torch.where(lit, light, 1.0), 0.0)
    variance = passed_squared / torch.where(lit, light_squared, 1.0) - quotient * quotient
    quotient = torch.where(variance < _ROUGH**2, quotient, 0.0)
    number = lit.to(quotient.dtype).sum(1, keepdim=True)
    # The third part of the hundred blocks that are brightest: reflections stand above it.
    kept = max(1, round(_TOP * quotient.shape[1]))
    gain = quotient.topk(kept, dim=1).values[:, -1:]
    for width in _WIDTHS:
        near = ((quotient - gain).abs() <= width * gain).to(quotient.dtype)
        gain = (quotient * near).sum(1, keepdim=True) / near.sum(1, keepdim=True).clamp_min(1)
    distance = quotient / gain.clamp_min(1e-6) - 1
    glass = ((distance.abs() <= _NARROW) & lit).to(quotient.dtype).sum(1, keepdim=True)
    beside = ((distance < -_NARROW) & (distance >= -_BESIDE)).to(quotient.dtype).sum(1, keepdim=True)
    seen = (gain > _LEAST) & (gain < _MOST) & (glass >= _TOP * number) & (glass >= 2 * beside)
    return torch.where(seen, gain, torch.nan).squeeze(1)
