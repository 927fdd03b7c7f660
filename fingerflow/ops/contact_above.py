"""From camera counts to the pixels that touch by a given threshold, without a picture between them."""

from torch import Tensor

from fingerflow import kernels
from fingerflow.ops.illumination import check_images, light_lost
from fingerflow.ops.median import median_above


def contact_above(
    frames: Tensor,
    reference: Tensor,
    dark: Tensor | None = None,
    *,
    threshold: Tensor,
    median_px: int = 9,
    minimum_illumination: float = 0.05,
) -> Tensor:
    """Where the median of the signal of `light_lost` lies above a threshold, and the signal is known.

    Args:
        frames, reference, dark, minimum_illumination: as for `normalize_illumination`.
        threshold: (B,) share of light lost; NaN is exceeded nowhere.
        median_px: odd side of the median; 1 for none.

    Returns:
        (B, 1, H, W) bool.

    Raises:
        ValueError: as these ops.
    """
    images = [image for image in (frames, reference, dark) if image is not None]
    check_images(images, minimum_illumination)
    if (
        median_px % 2 == 1
        and 1 <= median_px <= kernels.LARGEST_MEDIAN_ABOVE
        and threshold.shape == frames.shape[:1]
        and all(image.dtype in kernels.FRAME_KINDS for image in images)
        and kernels.serve(*images, threshold)
    ):
        return kernels.contact_above(frames, reference, dark, minimum_illumination, threshold.double(), median_px)
    lost = light_lost(frames, reference, dark, minimum_illumination=minimum_illumination)
    return median_above(lost.signal, threshold, median_px) & lost.valid
