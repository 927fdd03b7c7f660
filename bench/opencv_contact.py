"""Contact mask of a frame with OpenCV alone, as a user without this project would compute it."""

from collections.abc import Callable

import cv2
import numpy as np
import torch
from torch import Tensor

from fingerflow.ops.filters.illumination import normalize_illumination


def opencv_contact(frame: Tensor, empty: Tensor, median_px: int) -> Callable[[], Tensor]:
    """Return a call that finds the contact (H, W) bool: illumination quotient, one byte a pixel, median, Otsu, count.

    Frames are (1, 1, H, W) of 8 bit. What depends on the empty glass alone is computed before the call.
    """
    pixels, reference = frame[0, 0].numpy(), empty[0, 0].numpy().astype(np.float32)
    lit = normalize_illumination(frame, empty).valid[0, 0].numpy()
    unlit, lit_byte = ~lit, lit.astype(np.uint8)

    def contact() -> Tensor:
        quotient = cv2.divide(pixels, reference, dtype=cv2.CV_32F)
        quotient[unlit] = 1
        # round(255 (1 - quotient + 0.25) / 1.25), saturating
        levels = cv2.addWeighted(quotient, -204, quotient, 0, 255, dtype=cv2.CV_8U)
        smooth = cv2.medianBlur(levels, median_px) if median_px > 1 else levels
        threshold, _ = cv2.thresholdWithMask(smooth, np.zeros_like(smooth), lit_byte, 0, 1, cv2.THRESH_OTSU)
        _, touching = cv2.threshold(smooth, threshold, 255, cv2.THRESH_BINARY)
        cv2.countNonZero(touching)
        return torch.from_numpy(touching) > 0

    return contact
