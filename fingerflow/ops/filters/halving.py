"""Reduction of images to half resolution."""

from torch import Tensor

from fingerflow.kernels.tensors import Twin, twin
from fingerflow.ops.checks import check_pixels

_compiled: Twin[Tensor] = twin("halve")


def halved_image(images: Tensor) -> Tensor:
    """Halve the resolution of images (B, 1, H, W) by averaging blocks of 2 x 2 px; sides are at least 3 px.

    This is several times as fast as torch's pooling.

    Returns:
        (B, 1, H // 2, W // 2), without the last row or column of odd sizes, of the dtype of floating images, else
        float32.

    Raises:
        ValueError: smaller images.
    """
    check_pixels(images, 3)
    if _compiled.serves(images):
        return _compiled(images)
    height, width = images.shape[-2] // 2 * 2, images.shape[-1] // 2 * 2
    images = images if images.is_floating_point() else images.float()
    rows = images[..., 0:height:2, :width] + images[..., 1:height:2, :width]
    return (rows[..., 0::2] + rows[..., 1::2]) / 4
