"""Illumination gain and real contact mask by kernels of Triton: two launches and one for all frames.

They take the steps of `ops.contact.illumination_gain` and `ops.contact.real_contact_mask`. The counts of a mask are
those of the portable form bit for bit, the gain is to rounding.
"""

import math

import torch
import triton
import triton.language as tl
from torch import Tensor

from fingerflow.kernels import contact_sizes as sizes
from fingerflow.kernels.tensors.fused_ranks import value_of_rank

PIXELS = 1024  # of a program

_STEP = tl.constexpr(sizes.LINE_STEP)
_LIT, _ROUGH, _TOP = tl.constexpr(sizes.LIT), tl.constexpr(sizes.ROUGH), tl.constexpr(sizes.TOP)
_LEAST, _MOST = tl.constexpr(sizes.LEAST_GAIN), tl.constexpr(sizes.MOST_GAIN)
_NARROW, _BESIDE = tl.constexpr(sizes.NARROW_GLASS), tl.constexpr(sizes.BESIDE_GLASS)
_INF = tl.constexpr(float("inf"))


def illumination_gain(frames: Tensor, light: Tensor, black: Tensor, block: int) -> Tensor:
    """Return the illumination gain (B,) of frames (B, 1, H, W), as `kernels.contact.illumination_gain`."""
    batch, (height, width) = len(frames), frames.shape[-2:]
    lines = len(range(sizes.LINE_STEP // 2, height, sizes.LINE_STEP))
    rows, columns = lines // (block // sizes.LINE_STEP), width // block
    gain = light.new_full((batch,), torch.nan)
    count = rows * columns
    if batch and count:
        sums = light.new_empty(batch, 4, count)
        _sum_blocks[(rows, batch)](
            *(frames.contiguous(), light.contiguous(), black.contiguous(), sums),
            *(height, width, columns, len(light), len(black), block),
            COLUMNS=triton.next_power_of_2(columns),
            BLOCK=triton.next_power_of_2(block),
        )
        kept = count - max(1, round(sizes.TOP * count))
        _find_mode[(batch,)](sums, gain, count, kept, *sizes.WIDTHS, BLOCKS=triton.next_power_of_2(count), num_warps=8)
    return gain


def real_contact_mask(frames: Tensor, light: Tensor, black: Tensor, share: Tensor, size: int) -> Tensor:
    """Return the real contact mask (B, 1, H, W) bool of frames, as `kernels.contact.real_contact_mask`."""
    batch, (height, width) = len(frames), frames.shape[-2:]
    mask = torch.empty(frames.shape, dtype=torch.bool, device=frames.device)
    if mask.numel():
        _mark[(-(-height * width // PIXELS), batch)](
            *(frames.contiguous(), light.contiguous(), black.contiguous(), share.contiguous(), mask.view(torch.uint8)),
            *(height, width, len(light), len(black), size // 2),
            PIXELS=PIXELS,
            HIGHEST=255.0 if frames.dtype == torch.uint8 else math.inf,
            enable_fp_fusion=False,  # limits are rounded as in the portable form
        )
    return mask


@triton.jit
def _sum_blocks(
    frames,
    light,
    black,
    sums,
    height,
    width,
    columns,
    light_batch,
    black_batch,
    block,
    COLUMNS: tl.constexpr,
    BLOCK: tl.constexpr,
):
    frame = tl.program_id(1).to(tl.int64)
    size = height * width
    frames += frame * size
    light += tl.where(light_batch == 1, 0, frame) * size
    black += tl.where(black_batch == 1, 0, frame) * size
    column = tl.arange(0, COLUMNS)[:, None]
    beside = tl.arange(0, BLOCK)[None, :]
    there = (column < columns) & (beside < block)
    passed_sum = tl.zeros((COLUMNS, BLOCK), tl.float32)
    passed_squares = tl.zeros((COLUMNS, BLOCK), tl.float32)
    light_sum = tl.zeros((COLUMNS, BLOCK), tl.float32)
    light_squares = tl.zeros((COLUMNS, BLOCK), tl.float32)
    lines = block // _STEP
    for line in range(lines):
        row = (tl.program_id(0) * lines + line) * _STEP + _STEP // 2
        at = row * width + column * block + beside
        value = tl.load(frames + at, mask=there, other=0).to(tl.float32)
        given = tl.load(light + at, mask=there, other=0.0)
        dark = tl.load(black + at, mask=there, other=0.0)
        finite = tl.abs(value) < _INF
        given = tl.where(finite, given, 0.0)
        passed = tl.where(given > 0, tl.where(finite, value, 0.0) - dark, 0.0)
        passed_sum += passed
        passed_squares += passed * passed
        light_sum += given
        light_squares += given * given
    count = tl.num_programs(0) * columns
    block_number = tl.program_id(0) * columns + tl.arange(0, COLUMNS)
    to = sums + frame * 4 * count + block_number
    stored = tl.arange(0, COLUMNS) < columns
    tl.store(to, tl.sum(passed_sum, 1), mask=stored)
    tl.store(to + count, tl.sum(passed_squares, 1), mask=stored)
    tl.store(to + 2 * count, tl.sum(light_sum, 1), mask=stored)
    tl.store(to + 3 * count, tl.sum(light_squares, 1), mask=stored)


@triton.jit
def _mean_near(quotient, gain, width):
    """Return the mean of the quotients that differ from a gain by less than a relative width."""
    near = tl.where(tl.abs(quotient - gain) <= width * gain, 1.0, 0.0)
    return tl.sum(quotient * near, 1)[:, None] / tl.maximum(tl.sum(near, 1)[:, None], 1.0)


@triton.jit
def _find_mode(sums, gains, count, kept, width_1, width_2, width_3, width_4, BLOCKS: tl.constexpr):
    frame = tl.program_id(0).to(tl.int64)
    block = tl.arange(0, BLOCKS)[None, :]
    there = block < count
    own = sums + frame * 4 * count + block
    passed = tl.load(own, mask=there, other=0.0)
    passed_squares = tl.load(own + count, mask=there, other=0.0)
    light = tl.load(own + 2 * count, mask=there, other=0.0)
    light_squares = tl.load(own + 3 * count, mask=there, other=0.0)
    lit = there & (light > tl.max(light, 1)[:, None] * _LIT)
    quotient = tl.where(lit, passed / tl.where(lit, light, 1.0), 0.0)
    variance = passed_squares / tl.where(lit, light_squares, 1.0) - quotient * quotient
    quotient = tl.where(variance < _ROUGH * _ROUGH, quotient, 0.0)
    number = tl.sum(tl.where(lit, 1.0, 0.0), 1)[:, None]
    # Start from the least of the brightest blocks: reflections lie above it.
    gain = value_of_rank(quotient, there, tl.zeros((1, 1), tl.int32) + kept)
    gain = _mean_near(quotient, gain, width_1)
    gain = _mean_near(quotient, gain, width_2)
    gain = _mean_near(quotient, gain, width_3)
    gain = _mean_near(quotient, gain, width_4)
    distance = quotient / tl.maximum(gain, 1e-6) - 1
    glass = tl.sum(tl.where(lit & (tl.abs(distance) <= _NARROW), 1.0, 0.0), 1)[:, None]
    below = there & (distance < -_NARROW) & (distance >= -_BESIDE)
    beside = tl.sum(tl.where(below, 1.0, 0.0), 1)[:, None]
    seen = (gain > _LEAST) & (gain < _MOST) & (glass >= number * _TOP) & (glass >= 2 * beside)
    tl.store(gains + frame + tl.zeros((1, 1), tl.int32), tl.where(seen, gain, float("nan")))


@triton.jit
def _mark(
    frames,
    light,
    black,
    share,
    mask,
    height,
    width,
    light_batch,
    black_batch,
    half,
    PIXELS: tl.constexpr,
    HIGHEST: tl.constexpr,
):
    frame = tl.program_id(1).to(tl.int64)
    size = height * width
    frames += frame * size
    light += tl.where(light_batch == 1, 0, frame) * size
    black += tl.where(black_batch == 1, 0, frame) * size
    limit = tl.load(share + frame)
    pixel = tl.program_id(0) * PIXELS + tl.arange(0, PIXELS)
    there = pixel < size
    row = pixel // width
    column = pixel % width
    number = tl.zeros((PIXELS,), tl.int32)
    for down in range(-half, half + 1):
        for along in range(-half, half + 1):
            # Beyond the frame the nearest pixel counts.
            at_row = tl.minimum(tl.maximum(row + down, 0), height - 1)
            at_column = tl.minimum(tl.maximum(column + along, 0), width - 1)
            at = at_row * width + at_column
            given = tl.load(light + at, mask=there, other=0.0)
            dark = tl.load(black + at, mask=there, other=0.0)
            value = tl.load(frames + at, mask=there, other=0).to(tl.float32)
            lit = given != 0
            # A byte at its highest value is not below any limit, as in the portable form.
            number += tl.where((value < tl.minimum(limit * tl.where(lit, given, 1.0) + dark, HIGHEST)) & lit, 1, 0)
    most = (2 * half + 1) * (2 * half + 1) // 2
    lit = tl.load(light + pixel, mask=there, other=0.0) != 0
    tl.store(mask + frame * size + pixel, tl.where(lit & (number > most), 1, 0).to(tl.uint8), mask=there)
