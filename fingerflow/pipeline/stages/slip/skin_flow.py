"""Displacement of every skin pixel from the first frame to each later frame, by dense optical flow, and how much this
flow blurs the border of a stick region.
"""

from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from fingerflow.kernels.array_types import Field, Mask, Series
from fingerflow.models.partial_slip.stick_border import RampResponse
from fingerflow.ops.flow.dense_flow import FlowTemplate, find_flow, prepare_flow
from fingerflow.ops.flow.flow_constancy import LEFT_BY_NOISE
from fingerflow.tracker.recorded.new_skin import distances

ROUGHNESS = 0.2  # roughness for `ops.dense_flow`: skin beside a stick region is stretched by 0.15 to 0.3
_TEXTURE_PX = 17  # px, side of the window over which texture is measured: one period of the ridges
# Largest residual as a share of the standard deviation of texture: an error of 0.8 px at a ridge has it; correct flow
# leaves 0.2.
_LEFT = 0.35
_FEWEST = 0.5  # least `FlowMotion.explained`; below, another initial displacement is tried
_INSIDE = 0.4  # share of the mask that lies inside the simulated border
_LARGEST_PX = 3.0  # px, simulated displacement at the end of the mask
_REACH_PX = 32  # px on either side of the border; farther away the border does not affect the flow
_STEP_PX = 0.5
_ROUNDS = 20  # iterations of the inversion; the error shrinks by the displacement gradient in each
_SHORTEST_PX = 4  # px, least distance from the border to the end of the mask


class FlowMotion(NamedTuple):
    """Displacement of all skin pixels from the first frame to a later frame, with the variance due to image noise.

    Attributes:
        displacement: (H, W, 2) px of the skin at each pixel of the first picture; NaN where the flow is rejected.
        variance: (H, W) px^2 of a component, by image noise.
        explained: mean over the skin of 1 where no residual is left, down to 0 where the flow is rejected.
    """

    displacement: Field
    variance: Field
    explained: float


class SkinFlow:
    """Dense optical flow (`ops.dense_flow`) from the first frame to each later frame, initialised by the last two
    results.

    The smoothness is set for a slipping rim. With the default of `ops.dense_flow`, for a finger that widens evenly,
    errors on `fingerflow.synthetic.PartialSlip` are 0.10 to 0.22 px in the slip region; with this one they are 0.05 to
    0.09. In the stick region they are 0.020 to 0.035 instead of 0.010 to 0.1.

    A pixel is accepted where flow and light explain seven eighths of the texture's variance around it, and the
    displacement of the nearest tracked point differs by less than a quarter of the ridge distance. Where too little is
    explained, the flow starts again from the points. If that does not help either, the reference picture is updated:
    the last picture that was explained, warped back to the first one, replaces it. From then on its errors add to all
    later ones, and skin that was not known in it is lost.

    Args:
        image: (1, 1, H, W) the first picture.
        mask: (H, W) bool of the skin.
        apart_px: largest difference from the nearest point: a quarter of the ridge distance.

    Attributes:
        renewed: number of updates of the reference picture.
    """

    def __init__(self, image: Tensor, mask: Mask, apart_px: float) -> None:
        self._apart = apart_px
        self.renewed = 0
        self._mask = mask
        # Variance of the reference picture's displacement from the first frame.
        self._walked = np.zeros(mask.shape, np.float32)
        self._compare_with(image, mask, None)
        self._noise = self.template.variance.sqrt()
        self._last = image.new_zeros((1, 2, *mask.shape), dtype=self.template.value.dtype)
        self._speed = torch.zeros_like(self._last)
        self._known = FlowMotion(np.zeros((*mask.shape, 2), np.float32), self._walked, 1.0)
        self._picture: Tensor | None = None  # last explained picture, None right after a reference update

    def follow(self, image: Tensor, positions: Field, moved: Field) -> FlowMotion:
        """Return the displacement of the skin from the first frame to `image`, the next frame of the recording.

        Args:
            image: (1, 1, H, W).
            positions: (P, 2) px of tracked points in the first picture.
            moved: (P, 2) px, their displacement in this one, NaN where lost. Where the flow is lost it starts again
                from that of the nearest points.
        """
        seen = np.isfinite(moved).all(-1)
        nearest = np.full((*self._mask.shape, 2), np.nan, np.float32)
        if seen.any():
            nearest = moved[seen][distances(positions[seen], self._mask.shape)[1]]
        smooth = cv2.blur(np.nan_to_num(nearest), (_TEXTURE_PX, _TEXTURE_PX))
        start, again = self._last + self._speed, _planes(np.asarray(smooth, np.float32), self._last)
        start = torch.where(start.isfinite(), start, again)
        motion = self._match(image, start, 1, nearest)
        if motion.explained < _FEWEST:
            motion = _better(motion, self._match(image, again, 2, nearest))
            if motion.explained < _FEWEST and self._picture is not None:
                self._renew(self._picture)
                motion = _better(motion, self._match(image, again, 2, nearest))
        here = _planes(motion.displacement, start)
        # The speed is set to 0 after a jump.
        step = (here - self._last).nan_to_num(0.0)
        self._speed = step if float(step.norm(dim=1).max()) < self._apart else torch.zeros_like(step)
        self._last = here
        if motion.explained >= _FEWEST:
            self._known, self._picture = motion, image.clone()
        return motion

    def _compare_with(self, image: Tensor, mask: Mask, noise: Tensor | None) -> None:
        inside = torch.from_numpy(mask).to(image.device)[None, None]
        self.template = prepare_flow(image, inside, roughness=ROUGHNESS, noise=noise)
        value = self.template.value[0, 0].cpu().numpy()
        size = (_TEXTURE_PX, _TEXTURE_PX)
        mean, squares = (cv2.blur(picture, size, borderType=cv2.BORDER_REFLECT) for picture in (value, value * value))
        self._texture = np.sqrt(np.maximum(squares - mean * mean, 0))
        self._compared = mask

    def _match(self, image: Tensor, start: Tensor, warps: int, nearest: Field) -> FlowMotion:
        flow = find_flow(self.template, image, start, warps)
        displacement = flow.displacement[0].permute(1, 2, 0).cpu().numpy()
        residual = flow.residual[0, 0].cpu().numpy()
        variance = (flow.covariance[0, 0, 0] + flow.covariance[0, 1, 1]).cpu().numpy() / 2
        of_noise = LEFT_BY_NOISE["brightness"] ** 2 * float(self.template.variance)
        left = np.sqrt(np.maximum(residual**2 - of_noise, 0)) / np.maximum(_LEFT * self._texture, 1e-6)
        contradicted = np.linalg.norm(displacement - nearest, axis=-1) > self._apart  # False where no point is tracked
        variance += self._walked
        believed = np.isfinite(variance) & (left < 1) & ~contradicted
        shown = np.where(believed[..., None], displacement, np.float32(np.nan)).astype(np.float32, copy=False)
        explained = float(np.where(believed, 1 - left, 0)[self._compared].mean())
        return FlowMotion(shown, np.where(believed, variance, np.nan).astype(np.float32), explained)

    def _renew(self, picture: Tensor) -> None:
        """Replace the reference image of the flow by a later frame `picture` (1, 1, H, W), warped back to the first
        frame by the displacement found for it.
        """
        valid = np.isfinite(self._known.variance)
        y, x = np.indices(valid.shape, dtype=np.float32)
        went = np.nan_to_num(self._known.displacement)
        pixels = picture[0, 0].cpu().numpy().astype(np.float32)
        back = cv2.remap(pixels, x + went[..., 0], y + went[..., 1], cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT)
        self._walked = self._known.variance
        self._compare_with(torch.from_numpy(back)[None, None].to(picture.device), valid, self._noise)
        self.renewed, self._picture = self.renewed + 1, None


def _better(first: FlowMotion, second: FlowMotion) -> FlowMotion:
    return max(first, second, key=lambda motion: motion.explained)


def _planes(field: Field, like: Tensor) -> Tensor:
    """Convert a vector field (H, W, 2) from a NumPy array to a tensor (1, 2, H, W)."""
    return torch.from_numpy(field.transpose(2, 0, 1)[None]).to(like)


def flow_response(template: FlowTemplate, image: Tensor, mask: Mask, mm_per_px: float) -> RampResponse:
    """Return the displacement that dense optical flow measures near a slip border, where the true displacement is 0 up
    to the border and increases linearly beyond it (a ramp), as a function of the signed distance, mm, outside of it.

    The smoothing of the flow depends on texture and noise, so it is not known beforehand. The picture itself is
    displaced by a ramp beyond a border, along x and along y, and the flow is computed. The noise of the picture moves
    with it, so that only the blur remains. On the synthetic trials the flow shows at the border what windows of 8 px
    would, and overshoots a little beside it. Farther inside than was measured the displacement is 0; farther outside
    the error is that of the last measured distance.

    Args:
        template: of ``image``.
        image: (1, 1, H, W).
        mask: (H, W) bool of the skin.
        mm_per_px: of the picture.
    """
    depth = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    border = max(float(np.quantile(depth[mask], 1 - _INSIDE)), _SHORTEST_PX)
    beyond = (border - depth).astype(np.float32)  # px, distance beyond the border
    growth = _LARGEST_PX / border
    length = (growth * np.maximum(beyond, 0)).astype(np.float32)
    distances = np.arange(-_REACH_PX, min(_REACH_PX, border - _SHORTEST_PX) + _STEP_PX, _STEP_PX)
    excess = np.mean([_blur(template, image, length, mask, beyond, distances, axis) for axis in (0, 1)], axis=0)
    measured = np.isfinite(excess)
    blur = excess[measured] / growth * mm_per_px
    distances = distances[measured] * mm_per_px

    def response(distance: Series) -> Series:
        return np.maximum(distance, 0) + (np.interp(distance, distances, blur, left=0.0) if len(blur) else 0.0)

    return response


def _blur(
    template: FlowTemplate, image: Tensor, length: Field, mask: Mask, beyond: Field,
    distances: Series, axis: int,
) -> Series:  # fmt: skip
    """Return the mean error (K,) px of dense flow at `distances` (K,) px beyond a border, measured on the image after
    shifting each pixel along `axis` by a known `length` (H, W) px.

    `beyond` (H, W) px is the distance of each pixel beyond the border.
    """
    picture = image[0, 0].cpu().numpy().astype(np.float32)
    height, width = picture.shape
    pixel = [part.astype(np.float32) for part in np.meshgrid(np.arange(width), np.arange(height))]
    position = [*pixel]  # at which the skin of a pixel was: position + length(position) = pixel
    for _ in range(_ROUNDS):
        gone = cv2.remap(length, position[0], position[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        position[axis] = np.asarray(pixel[axis] - gone)
    x, y = position
    moved = np.asarray(cv2.remap(picture, x, y, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE))
    start = np.zeros((1, 2, height, width), np.float32)
    start[0, axis] = length
    displaced, initial = (torch.from_numpy(array).to(image.device) for array in (moved[None, None], start))
    flow = find_flow(template, displaced, initial, warps=2).displacement[0, axis].cpu().numpy()
    counted = mask & np.isfinite(flow)
    near = [counted & (np.abs(beyond - at) < 1) for at in distances]
    return np.array([(flow - length)[here].mean() if here.any() else np.nan for here in near])
