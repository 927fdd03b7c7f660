"""From camera counts to the pixels that touch, in one go: light lost, smoothed, split by Otsu's threshold."""

from typing import NamedTuple

import torch
from torch import Tensor

from fingerflow import kernels
from fingerflow.ops.illumination import LEVEL_RANGE, check_images, levels_per_unit, light_lost
from fingerflow.ops.median import median_filter
from fingerflow.ops.otsu import ClassSeparation, otsu_classes


class ContactClasses(NamedTuple):
    """What frames (B, 1, H, W) show of contact.

    Attributes:
        valid: (B, 1, H, W) bool, where the share of light lost is known.
        smooth: (B, 1, H, W) uint8, the same in levels (`quantize`), median-filtered.
        touching: (B, 1, H, W) bool, `smooth` above the threshold; nowhere where that is NaN.
        threshold: (B,) float64, Otsu's level of the valid pixels of `smooth`.
        classes: the `ClassSeparation` at it.
    """

    valid: Tensor
    smooth: Tensor
    touching: Tensor
    threshold: Tensor
    classes: ClassSeparation


def contact_classes(
    frames: Tensor,
    reference: Tensor,
    dark: Tensor | None = None,
    *,
    median_px: int = 9,
    minimum_illumination: float = 0.05,
) -> ContactClasses:
    """`light_lost`, `median_filter` of its levels, and `otsu_classes` of the valid ones.

    Args:
        frames, reference, dark, minimum_illumination: as for `normalize_illumination`.
        median_px: odd side of the median; 1 for none.

    Raises:
        ValueError: as these ops.
    """
    images = [image for image in (frames, reference, dark) if image is not None]
    check_images(images, minimum_illumination)
    compiled = median_px % 2 == 1 and 1 <= median_px <= kernels.LARGEST_MEDIAN
    if compiled and all(image.dtype in kernels.FRAME_KINDS for image in images) and kernels.serve(*images):
        low, scale = LEVEL_RANGE[0], levels_per_unit(*LEVEL_RANGE)
        pictures, numbers = kernels.contact_classes(
            frames, reference, dark, minimum_illumination, low, scale, median_px
        )
        return ContactClasses(*pictures, threshold=numbers.threshold, classes=ClassSeparation(*numbers[1:]))
    _, levels, valid = light_lost(frames, reference, dark, minimum_illumination=minimum_illumination)
    smooth = median_filter(levels, median_px)
    threshold, classes = otsu_classes(smooth, valid)
    touching = smooth > threshold.to(torch.float32).reshape(-1, 1, 1, 1)
    return ContactClasses(valid, smooth, touching, threshold, classes)
