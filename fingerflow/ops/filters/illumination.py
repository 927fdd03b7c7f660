"""Contact signal from camera counts: normalisation by the empty glass, intensity loss, quantisation to one byte."""

from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow.kernels.contact_sizes import FULL_LIGHT, LEAST_LIGHT, PIXELS_OF_LIGHT
from fingerflow.kernels.tensors import Twin, twin
from fingerflow.ops.checks import check_images
from fingerflow.ops.filters.quantile import frame_quantile

# Signal at grey level 0, and levels per unit of the signal; a signal of 1 has level 255. Negative signals are pixels
# brighter than the empty glass.
LOWEST_SIGNAL = -0.25
LEVELS_PER_UNIT = 255 / (1 - LOWEST_SIGNAL)

_compiled: Twin[tuple[Tensor, Tensor]] = twin("normalize")


class NormalizedFrames(NamedTuple):
    """Frames divided by the light of the empty glass, and a mask of the pixels where this quotient is known.

    `frames` (B, 1, H, W) is the light relative to that of the empty glass; `valid` (B, 1, H, W) bool is True where this
    quotient is known.
    """

    frames: Tensor
    valid: Tensor


def normalize_illumination(
    frames: Tensor, reference: Tensor, dark: Tensor | None = None, *, minimum_illumination: float = LEAST_LIGHT
) -> NormalizedFrames:
    """Divide frames by the light of the empty glass: (frames - dark) / (reference - dark), where the reference is lit.

    Outside the lit disc the quotient is noise divided by noise. A pixel is masked (valid False, quotient exactly 1 as
    for empty glass) where reference - dark is at most `minimum_illumination` of its own 0.99 quantile or not positive,
    or where any input or the quotient is not finite. At the default limit of 5 % one count of camera noise on an 8-bit
    reference of 200 counts becomes 0.1 in the quotient, twenty times the noise at full light.

    A saturated pixel is used as it is, since a dtype does not define the camera's white level. The quotient is too
    small where a frame saturates (bright, never mistaken for contact) and too large where the reference saturates.

    Args:
        frames: (B, 1, H, W), integers of 8 to 16 bit or floating, in camera counts.
        reference: (1 or B, 1, H, W), the empty glass under the same light, in the same counts.
        dark: (1 or B, 1, H, W), counts without light; None for zero.
        minimum_illumination: least light at which the quotient is used, as a fraction of full light.

    Returns:
        `frames` float32 (float64 if any input is), `valid` bool, both (B, 1, H, W). `frames` is differentiable where
        valid.

    Raises:
        ValueError: shapes that do not fit, or `minimum_illumination` outside 0 to 1.

    Source: Willemet et al. 2021, figure S3 A. Compiled twin: `kernels/illumination.cpp`.

    Convention:
        axes: rows are y down, columns x to the right; each pixel stands alone but for the full light.
        sign: 1 is the empty glass, less is darker.
        pixel centre: frames and reference share their pixels.
        dtype: float32, or float64 if an input is.
        NaN: in a pixel of an input, makes it not valid, with quotient 1.
        border: none, each pixel stands alone but for the full light.
    """
    images = [image for image in (frames, reference, dark) if image is not None]
    if not 0 <= minimum_illumination < 1:
        raise ValueError(f"minimum_illumination is {minimum_illumination}: give a fraction of full light from 0 to 1")
    check_images(frames, reference=reference, dark=dark)
    precision = torch.float64 if any(image.dtype == torch.float64 for image in images) else torch.float32
    empty, *black = (image.to(precision) for image in images[1:])
    light = empty - black[0] if black else empty
    least = minimum_illumination * _full_light(light)
    if _compiled.serves(frames, light):
        none = black[0] if black else torch.zeros_like(light[:1])
        return NormalizedFrames(*_compiled(frames, light, none, least))
    counts = frames.to(precision)
    passed = counts - black[0] if black else counts

    lit = _exceeds(light, least) & torch.isfinite(passed)
    # Both branches of `where` are differentiated, so the values replaced must be finite too.
    quotient = torch.where(lit, passed, 1.0) / torch.where(lit, light, 1.0)
    valid = lit & torch.isfinite(quotient)
    return NormalizedFrames(torch.where(valid, quotient, 1.0), valid)


def glass_light(
    empty: Tensor, dark: Tensor | None = None, precision: torch.dtype = torch.float32
) -> tuple[Tensor, Tensor]:
    """Return the light of the empty glass and the black level per pixel, in camera counts.

    Args:
        empty: (B, 1, H, W) counts of the empty glass, one frame or the mean of several.
        dark: the same without light; None for zero.
        precision: dtype of the result.

    Returns:
        (B, 1, H, W) each: light = empty - dark, 0 where the glass is not lit (as in `normalize_illumination` at its
        default limit), and black = dark, 0 where it is not finite.

    Raises:
        ValueError: shapes that do not fit.
    """
    check_images(empty, dark=dark)
    counts = empty.to(precision)
    black = torch.zeros_like(counts) if dark is None else dark.to(precision).expand(counts.shape)
    light = counts - black
    lit = _exceeds(light, LEAST_LIGHT * _full_light(light))
    return torch.where(lit, light, 0.0), torch.where(black.abs() < torch.inf, black, 0.0)


def _full_light(light: Tensor) -> Tensor:
    """Return the full light (B,) of images (B, 1, H, W): a high quantile of the light of all pixels."""
    step = max(1, min(light.shape[-2:]) // PIXELS_OF_LIGHT)
    return frame_quantile(light.detach()[..., ::step, ::step], FULL_LIGHT).to(light.dtype)


def _exceeds(light: Tensor, least: Tensor) -> Tensor:
    return torch.isfinite(light) & (light > 0) & (light > least.reshape(-1, 1, 1, 1))


def contact_signal(normalized: NormalizedFrames, first: NormalizedFrames | None = None) -> Tensor:
    """Compute the contact signal: the relative intensity loss per pixel since the empty glass, or since first contact.

    It is 1 - quotient, or first quotient - quotient. Contact is bright.

    Args:
        normalized: quotients (B, 1, H, W) of `normalize_illumination`.
        first: quotients (1 or B, 1, H, W) at the first instant of contact, for a signal relative to it.

    Returns:
        (B, 1, H, W): 0 for no change and where either quotient is masked, 1 for a complete loss of intensity.
    """
    if first is None:
        return 1 - normalized.frames
    return torch.where(normalized.valid & first.valid, first.frames - normalized.frames, 0.0)


def quantize(signal: Tensor) -> Tensor:
    """Quantise the contact signal to one byte: level = round(204 (signal + 0.25)), clipped to 0 to 255.

    One level is 0.0049, below the noise of one 8-bit camera pixel. The median and Otsu's threshold are computed from
    levels.

    Args:
        signal: any shape, floating. NaN becomes level 0, infinities saturate.

    Returns:
        uint8 of the same shape.
    """
    scaled = (signal - LOWEST_SIGNAL) * LEVELS_PER_UNIT
    return torch.nan_to_num(scaled, nan=0.0).clamp(0, 255).round().to(torch.uint8)


def dequantize(levels: Tensor) -> Tensor:
    """Convert quantised levels, such as a threshold, back to the contact signal; the inverse of `quantize`.

    Args:
        levels: any shape, uint8 or floating; NaN stays NaN.

    Returns:
        float32, or the dtype of floating `levels`.
    """
    values = levels if levels.is_floating_point() else levels.float()
    return values / LEVELS_PER_UNIT + LOWEST_SIGNAL
