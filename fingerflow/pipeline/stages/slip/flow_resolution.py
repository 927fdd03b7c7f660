"""Measure how much dense optical flow blurs the border of a stick region, in an image displaced by known amounts."""

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.ops.flow.dense_flow import FlowTemplate, find_flow

_INSIDE = 0.4  # share of the mask that lies inside the simulated border
_LARGEST_PX = 3.0  # px, simulated displacement at the end of the mask
_REACH_PX = 32  # px on either side of the border; farther away the border does not affect the flow
_STEP_PX = 0.5
_ROUNDS = 20  # iterations of the inversion; the error shrinks by the displacement gradient in each
_SHORTEST_PX = 4  # px, least distance from the border to the end of the mask

Field = NDArray[np.float32]


class FlowResponse:
    """Displacement that dense optical flow measures near a slip border, where the true displacement is 0 up to the
    border and increases linearly beyond it (a ramp).

    The smoothing of the flow depends on texture and noise, so it is not known beforehand. The picture itself is
    displaced by a ramp beyond a border, along x and along y, and the flow is computed. The noise of the picture moves
    with it, so that only the blur remains. On the synthetic trials the flow shows at the border what windows of 8 px
    would, and overshoots a little beside it.

    Args:
        template: of ``image``.
        image: (1, 1, H, W).
        mask: (H, W) bool of the skin.
        mm_per_px: of the picture.
    """

    def __init__(self, template: FlowTemplate, image: Tensor, mask: NDArray[np.bool_], mm_per_px: float) -> None:
        depth = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
        border = max(float(np.quantile(depth[mask], 1 - _INSIDE)), _SHORTEST_PX)
        beyond = (border - depth).astype(np.float32)  # px, distance beyond the border
        growth = _LARGEST_PX / border
        length = (growth * np.maximum(beyond, 0)).astype(np.float32)
        distances = np.arange(-_REACH_PX, min(_REACH_PX, border - _SHORTEST_PX) + _STEP_PX, _STEP_PX)
        excess = np.mean([_blur(template, image, length, mask, beyond, distances, axis) for axis in (0, 1)], axis=0)
        measured = np.isfinite(excess)
        blur = excess[measured] / growth
        self._distances, self._blur = distances[measured] * mm_per_px, blur * mm_per_px

    def __call__(self, distance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the displacement, mm, that the flow measures at signed distances in mm beyond the slip border.

        Farther inside than was measured it is 0; farther outside the error is that of the last measured distance.
        """
        blur = np.interp(distance, self._distances, self._blur, left=0.0) if len(self._blur) else 0.0
        return np.asarray(np.maximum(distance, 0) + blur)


def _blur(
    template: FlowTemplate,
    image: Tensor,
    length: Field,
    mask: NDArray[np.bool_],
    beyond: Field,
    distances: NDArray[np.float64],
    axis: int,
) -> NDArray[np.float64]:
    """Return the mean error (K,) px of dense flow at `distances` (K,) px beyond a border, measured on the image after
    shifting each pixel along `axis` by a known `length` (H, W) px.

    `beyond` (H, W) px is the distance of each pixel beyond the border.
    """
    picture = image[0, 0].cpu().numpy().astype(np.float32)
    height, width = picture.shape
    pixel = [part.astype(np.float32) for part in np.meshgrid(np.arange(width), np.arange(height))]
    x, y = pixel  # position at which the skin of a pixel was: position + length(position) = pixel
    for _ in range(_ROUNDS):
        gone = np.asarray(cv2.remap(length, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
        x, y = (pixel[0] - gone, y) if axis == 0 else (x, pixel[1] - gone)
    moved = np.asarray(cv2.remap(picture, x, y, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE))
    start = np.zeros((1, 2, height, width), np.float32)
    start[0, axis] = length
    displaced, initial = (torch.from_numpy(array).to(image.device) for array in (moved[None, None], start))
    flow = find_flow(template, displaced, initial, warps=2).displacement[0, axis].cpu().numpy()
    counted = mask & np.isfinite(flow)
    near = [counted & (np.abs(beyond - at) < 1) for at in distances]
    return np.array([(flow - length)[here].mean() if here.any() else np.nan for here in near])
