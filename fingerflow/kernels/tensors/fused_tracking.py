"""Templates followed through frames by one kernel of Triton: one launch for all points, recordings and frames.

A program is a point. It holds the template, cuts the patch of a frame, and takes the steps of `ops.tracking.templates`,
with its results to rounding; from frame to frame it predicts as `tracker.point_prediction` does. Of the two products
with B-spline weights that sample a window, the weights are computed where they are used.
"""

import math
from collections.abc import Sequence

import torch
import triton
import triton.language as tl
from torch import Tensor

from fingerflow.kernels import tracking_limits as limits
from fingerflow.kernels.tracking import FollowedPoints
from fingerflow.kernels.tracking_limits import NUMBERS, Number, TrackStatus

_INF = tl.constexpr(math.inf)
_NAN = tl.constexpr(math.nan)
_TINY = tl.constexpr(1e-20)
_NUMBERS = tl.constexpr(NUMBERS)
_INVERSE, _ENERGY, _LEVEL = (tl.constexpr(int(one)) for one in (Number.INVERSE_XX, Number.ENERGY, Number.LEVEL))
_CONSTANT, _NOISE, _TEXTURED = (tl.constexpr(int(one)) for one in (Number.CONSTANT_X, Number.NOISE, Number.TEXTURED))
_INSIDE, _GAIN, _COVARIANCE = (tl.constexpr(int(one)) for one in (Number.INSIDE, Number.GAIN, Number.COVARIANCE_XX))
_NOT_FINITE, _LEFT_FRAME = tl.constexpr(int(TrackStatus.NOT_FINITE)), tl.constexpr(int(TrackStatus.LEFT_FRAME))
_NO_TEXTURE, _NOT_CONVERGED = tl.constexpr(int(TrackStatus.NO_TEXTURE)), tl.constexpr(int(TrackStatus.NOT_CONVERGED))
_MISMATCH, _BACKWARD = tl.constexpr(int(TrackStatus.MISMATCH)), tl.constexpr(int(TrackStatus.FORWARD_BACKWARD))
_LEAST_GAIN, _MOST_GAIN = tl.constexpr(limits.LEAST_GAIN), tl.constexpr(limits.MOST_GAIN)
_REACH, _LAST_STEP = tl.constexpr(limits.REACH), tl.constexpr(limits.LAST_STEP)
_VALUE_NOISE, _SLACK = tl.constexpr(limits.VALUE_NOISE), tl.constexpr(limits.SLACK)
_LASTING, _SPEED_WEIGHT = tl.constexpr(1 - 1 / limits.SPEED_FRAMES), tl.constexpr(limits.SPEED_WEIGHT)


def find_templates(
    templates: Sequence[Tensor],
    frames: Tensor,
    place: Tensor,
    speed: Tensor | None,
    variance: Tensor | None,
    rounds: int,
    rounding: float,
    forward_backward_limit: float,
    mismatch_limit: float,
    lengths: Tensor | None = None,
) -> FollowedPoints[Tensor]:
    """Track the templates of B x N points through K frames each, as `kernels.tracking.find_templates`.

    `lengths` (B,) int32 are the numbers of frames of the recordings, K by default. What is found in frames after the
    last one of a recording is not defined; `place` and `speed` are those after its last frame.
    """
    start, samples, numbers = (one.contiguous() for one in templates)
    (batch, count, _), device = place.shape, frames.device
    steps, window = frames.shape[0] // max(batch, 1), math.isqrt(samples.shape[-1])
    frames = frames.contiguous()
    place = place.to(torch.float32).contiguous().clone()
    speed = torch.zeros_like(place) if speed is None else speed.to(torch.float32).contiguous().clone()
    if lengths is None:
        lengths = torch.full((batch,), steps, dtype=torch.int32, device=device)
    size = (steps, batch, count)
    points, estimate, covariance = (place.new_empty(*size, *last) for last in ((2,), (2,), (2, 2)))
    error, status = place.new_empty(size), place.new_empty(size, dtype=torch.uint8)
    if batch and count:
        _follow[(batch * count,)](
            *(start, samples, numbers, frames, place, speed, lengths),
            numbers if variance is None else variance,
            *(points, error, covariance, status, estimate),
            *(batch, count, frames.shape[2], frames.shape[3], rounds),
            *(rounding, forward_backward_limit, mismatch_limit),
            OWN_NOISE=variance is None,
            WINDOW=window,
            SIDE=max(16, triton.next_power_of_2(window + 6)),
        )
    return FollowedPoints(points, error, covariance, status, estimate, place, speed)


@triton.jit
def _spline(x):
    u = tl.maximum(2.0 - tl.abs(x), 0.0)
    v = tl.maximum(u - 1.0, 0.0)
    return (u * u * u - 4.0 * v * v * v) / 6.0


@triton.jit
def _weights(x):
    """Return the weight of a pixel at the distance x, px, from a sampled position: that of cubic B-spline
    interpolation, convolved with the smoothing mask (1, 2, 1) / 4 that gives the spline coefficients.
    """
    return (_spline(x - 1.0) + 2.0 * _spline(x) + _spline(x + 1.0)) / 4.0


@triton.jit
def _within(x, y, height, width, WINDOW: tl.constexpr):
    least = WINDOW // 2 - _SLACK
    return (x >= least) & (y >= least) & (x <= width - 1 - least) & (y <= height - 1 - least)


@triton.jit
def _follow(
    start,
    samples,
    numbers,
    frames,
    place,
    speed,
    lengths,
    variance,
    points,
    error,
    covariance,
    status,
    estimate,
    recordings,
    count,
    height,
    width,
    rounds,
    rounding,
    forward_backward_limit,
    mismatch_limit,
    OWN_NOISE: tl.constexpr,
    WINDOW: tl.constexpr,
    SIDE: tl.constexpr,
):
    point = tl.program_id(0).to(tl.int64)
    recording = point // count
    row = tl.arange(0, SIDE)[:, None]
    column = tl.arange(0, SIDE)[None, :]
    inside = (row < WINDOW) & (column < WINDOW)
    of_patch = (row < WINDOW + 6) & (column < WINDOW + 6)
    own = samples + point * (3 * WINDOW * WINDOW) + row * WINDOW + column
    value = tl.load(own, mask=inside, other=0.0)
    slope_x = tl.load(own + WINDOW * WINDOW, mask=inside, other=0.0)
    slope_y = tl.load(own + 2 * WINDOW * WINDOW, mask=inside, other=0.0)
    edge_x = ((column == WINDOW - 1).to(tl.float32) - (column == 0).to(tl.float32)) / 2.0
    edge_y = ((row == WINDOW - 1).to(tl.float32) - (row == 0).to(tl.float32)) / 2.0

    number = numbers + point * _NUMBERS
    inverse_xx = tl.load(number + _INVERSE)
    inverse_xy = tl.load(number + _INVERSE + 1)
    inverse_yy = tl.load(number + _INVERSE + 2)
    energy = tl.load(number + _ENERGY)
    level = tl.load(number + _LEVEL)
    constant_x = tl.load(number + _CONSTANT)
    constant_y = tl.load(number + _CONSTANT + 1)
    textured = tl.load(number + _TEXTURED) > 0
    key_inside = tl.load(number + _INSIDE) > 0
    free = tl.load(number + _GAIN) > 0
    spread_xx = tl.load(number + _COVARIANCE)
    spread_xy = tl.load(number + _COVARIANCE + 1)
    spread_yy = tl.load(number + _COVARIANCE + 2)
    known = tl.abs(tl.load(start + 2 * point) + tl.load(start + 2 * point + 1)) < _INF
    area: tl.constexpr = WINDOW * WINDOW
    border = tl.maximum(5, WINDOW + 6 - tl.minimum(height, width))

    place_x = tl.load(place + 2 * point)
    place_y = tl.load(place + 2 * point + 1)
    speed_x = tl.load(speed + 2 * point)
    speed_y = tl.load(speed + 2 * point + 1)
    seen = True
    for frame in range(tl.load(lengths + recording)):
        shown = frame * recordings + recording
        image = frames + shown * height * width
        noise = tl.load(number + _NOISE) if OWN_NOISE else tl.load(variance + shown)
        noise_energy = noise * (area * _VALUE_NOISE)
        expected_x = place_x + speed_x
        expected_y = place_y + speed_y
        next_x = expected_x
        next_y = expected_y
        found_x = expected_x
        found_y = expected_y
        off = expected_x
        scale = expected_x
        reason = 0
        left_rounds = rounds
        while left_rounds > 0:
            predicted = tl.abs(next_x) + tl.abs(next_y) < _INF
            given = known & predicted
            guess_x = tl.where(predicted, next_x, 0.0)
            guess_y = tl.where(predicted, next_y, 0.0)
            center_x = tl.floor(guess_x + 0.5)
            center_y = tl.floor(guess_y + 0.5)
            first_x = center_x - (WINDOW + 6) // 2
            first_y = center_y - (WINDOW + 6) // 2
            # Clamp to the same distance beyond the border to which the portable form replicates the border.
            first_x = tl.minimum(tl.maximum(first_x, 0.0 - border), 0.0 + width + border - (WINDOW + 6)).to(tl.int32)
            first_y = tl.minimum(tl.maximum(first_y, 0.0 - border), 0.0 + height + border - (WINDOW + 6)).to(tl.int32)
            at_x = tl.minimum(tl.maximum(first_x + column, 0), width - 1)
            at_y = tl.minimum(tl.maximum(first_y + row, 0), height - 1)
            patch = tl.load(image + at_y * width + at_x, mask=of_patch, other=0).to(tl.float32) - level
            patch = tl.where(of_patch, patch, 0.0)
            down = tl.where(row < WINDOW, _weights(guess_y - center_y - (column - row - 3)), 0.0)
            along = tl.where(column < WINDOW, _weights(guess_x - center_x - (row - column - 3)), 0.0)
            lines = tl.dot(down, patch, input_precision="ieee")
            matched = tl.dot(lines, along, input_precision="ieee")

            tm = tl.sum(value * matched)
            m1 = tl.sum(tl.where(inside, matched, 0.0))
            missing_x = tl.sum(slope_x * matched) - constant_x
            missing_y = tl.sum(slope_y * matched) - constant_y
            explaining = tm * tm / tl.maximum(energy, _TINY)
            gain = tl.where(free, tm / tl.maximum(energy, _TINY), 1.0)
            offset = tl.where(free, m1 / area, 0.0)
            residual = tl.where(inside, matched - gain * value - offset, 0.0)
            squared = residual * residual
            squares = tl.sum(squared)
            edges_x = tl.sum(squared * edge_x)
            edges_y = tl.sum(squared * edge_y)
            steep = tl.where(gain > 0, tl.maximum(gain, _LEAST_GAIN), 1.0 / _MOST_GAIN)
            last_x = (inverse_xx * missing_x + inverse_xy * missing_y) / steep
            last_y = (inverse_yy * missing_y + inverse_xy * missing_x) / steep
            converged = tl.sqrt(last_x * last_x + last_y * last_y) < _LAST_STEP
            found_x = guess_x - last_x
            found_y = guess_y - last_y

            left = squares - gain * (last_x * missing_x + last_y * missing_y)
            bb = squares + tl.where(free, explaining, 2.0 * tm - energy - m1 * m1 / area)
            unlike = left + (bb - explaining - squares)
            scale = tl.maximum(left / ((area - 4) * _VALUE_NOISE), 2.0 * rounding) / (gain * gain)
            off_x = inverse_xx * edges_x + inverse_xy * edges_y
            off_y = inverse_yy * edges_y + inverse_xy * edges_x
            off = tl.sqrt(off_x * off_x + off_y * off_y) / (gain * gain)
            common = tl.maximum(energy - noise_energy, 0.0) * tl.maximum(bb - noise_energy, 0.0)
            explained = tl.where(tm > 0, (bb - unlike) * energy, 0.0)
            begins = _within(guess_x, guess_y, height, width, WINDOW)
            ends = _within(found_x, found_y, height, width, WINDOW)
            within = key_inside & (ends | (begins & (converged == 0)))
            readable = tl.abs(m1 + level) < _INF
            # Set the reasons from the last to the first, so that the first that applies remains.
            reason = tl.where(off <= forward_backward_limit, 0, _BACKWARD)
            reason = tl.where(common * (1.0 - mismatch_limit) <= explained, reason, _MISMATCH)
            reason = tl.where(converged, reason, _NOT_CONVERGED)
            reason = tl.where(textured, reason, _NO_TEXTURE)
            reason = tl.where(readable, reason, _NOT_FINITE)
            reason = tl.where(within, reason, _LEFT_FRAME)
            reason = tl.where(given, reason, _NOT_FINITE)
            off = tl.where(given & within & readable & textured & converged, off, _NAN)
            known_step = (tl.abs(last_x) < _INF) & (tl.abs(last_y) < _INF)
            next_x = tl.where(known_step, guess_x - tl.minimum(tl.maximum(last_x, -_REACH), _REACH), guess_x)
            next_y = tl.where(known_step, guess_y - tl.minimum(tl.maximum(last_y, -_REACH), _REACH), guess_y)
            left_rounds = tl.where(reason == _NOT_CONVERGED, left_rounds - 1, 0)

        to = shown * count + point - recording * count
        tracked = reason == 0
        tl.store(points + 2 * to, tl.where(tracked, found_x, _NAN))
        tl.store(points + 2 * to + 1, tl.where(tracked, found_y, _NAN))
        tl.store(error + to, off)
        tl.store(covariance + 4 * to, tl.where(tracked, scale * spread_xx, _NAN))
        tl.store(covariance + 4 * to + 1, tl.where(tracked, scale * spread_xy, _NAN))
        tl.store(covariance + 4 * to + 2, tl.where(tracked, scale * spread_xy, _NAN))
        tl.store(covariance + 4 * to + 3, tl.where(tracked, scale * spread_yy, _NAN))
        tl.store(status + to, reason.to(tl.uint8))
        tl.store(estimate + 2 * to, next_x)
        tl.store(estimate + 2 * to + 1, next_y)

        moved = tracked & seen
        lasting = tl.where(tracked, 1.0, _LASTING)
        speed_x = speed_x * lasting + _SPEED_WEIGHT * tl.where(moved, next_x - expected_x, 0.0)
        speed_y = speed_y * lasting + _SPEED_WEIGHT * tl.where(moved, next_y - expected_y, 0.0)
        place_x = tl.where(tracked, next_x, expected_x)
        place_y = tl.where(tracked, next_y, expected_y)
        seen = tracked
    tl.store(place + 2 * point, place_x)
    tl.store(place + 2 * point + 1, place_y)
    tl.store(speed + 2 * point, speed_x)
    tl.store(speed + 2 * point + 1, speed_y)
