"""Where the skin of a first picture has gone, pixel by pixel, through the pictures that follow."""

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.ops.flow.dense_flow import Flow, find_flow, prepare_flow
from fingerflow.ops.flow.flow_constancy import LEFT_BY_NOISE

Field = NDArray[np.float32]
Mask = NDArray[np.bool_]

ROUGHNESS = 0.2  # of `ops.dense_flow`: skin beside a stuck part is stretched by 0.15 to 0.3
_TEXTURE_PX = 17  # side of the window over which texture is measured: a period of ridges
_LEFT = 0.35  # of the texture's deviation that may be left unexplained: 0.8 px of a ridge; rightly found skin has 0.2
_FEWEST = 0.5  # of what may be left unexplained is left on average, before another start is tried


class FlowMotion(NamedTuple):
    """Of a picture, against the first one.

    Attributes:
        displacement: (H, W, 2) px of what stood at each pixel of the first picture; NaN where it is not believed.
        variance: (H, W) px^2 of a component, of the noise of the pictures.
        explained: from 1, where nothing is left of the texture, to 0, where nothing is believed; mean over the skin.
    """

    displacement: Field
    variance: Field
    explained: float


class SkinFlow:
    """Dense flow (`ops.dense_flow`) against the first picture, each begun where the two before lead.

    The smoothness is set for a rim that slips: with the op's own, which is for a finger that widens evenly, errors on
    `fingerflow.synthetic.PartialSlip` are 0.10 to 0.22 px in the part that slips, with this one 0.05 to 0.09, for
    0.020 to 0.035 in place of 0.010 to 0.1 in the part that sticks.

    A pixel is believed where flow and light explain seven eighths of the texture's variance around it, and the nearest
    tracked point does not contradict it by a quarter of the ridges' distance. Where too little is explained, the flow
    is begun anew from the points, and where that does not help either the first picture is left: the last one that was
    explained, drawn as the skin lay in the first one, takes its place. Its errors are from then on in all that follow,
    and skin that was not known in it is not known any more.

    Args:
        image: (1, 1, H, W) the first picture.
        mask: (H, W) bool of the skin.
        apart_px: by how much a point contradicts: a quarter of the ridges' distance.

    Attributes:
        renewed: how often the first picture was left.
    """

    def __init__(self, image: Tensor, mask: Mask, apart_px: float) -> None:
        self._apart = apart_px
        self.renewed = 0
        self._mask = mask
        self._walked = np.zeros(mask.shape, np.float32)  # variance of the pictures that took the first one's place
        self._noise: Tensor | None = None
        self._compare_with(image, mask)
        self._noise = self.template.variance.sqrt()
        self._last = image.new_zeros((1, 2, *mask.shape), dtype=self.template.value.dtype)
        self._speed = torch.zeros_like(self._last)
        self._unsure = False  # whether skin of the last picture is not known, and begins from what is expected
        self._known = FlowMotion(np.zeros((*mask.shape, 2), np.float32), self._walked, 1.0)
        self._picture: Tensor | None = None  # the last one that was known, if it is another than that compared with

    def follow(self, image: Tensor, places: Field, moved: Field, expected: Callable[[], Field]) -> FlowMotion:
        """The motion in the next picture.

        Args:
            image: (1, 1, H, W).
            places: (P, 2) px of tracked points in the first picture.
            moved: (P, 2) px, their displacement in this one, NaN where lost.
            expected: gives a displacement (H, W, 2) px to begin from, where the flow is lost.
        """
        seen = np.isfinite(moved).all(-1)
        beside = _Nearest(places[seen], moved[seen], self._mask.shape, self._apart)
        start = self._last + self._speed
        if self._unsure:
            given = torch.from_numpy(expected().transpose(2, 0, 1)[None]).to(start)
            start = torch.where(start.isfinite(), start, given)
        found, motion = self._found(image, start, 1, beside)
        if motion.explained < _FEWEST:
            start = torch.from_numpy(expected().transpose(2, 0, 1)[None]).to(start)
            found, motion = _better((found, motion), self._found(image, start, 2, beside))
            if motion.explained < _FEWEST and self._picture is not None:
                self._renew(self._picture)
                found, motion = _better((found, motion), self._found(image, start, 2, beside))
        here = torch.from_numpy(motion.displacement.transpose(2, 0, 1)[None]).to(found.displacement)
        self._unsure = bool(np.isnan(motion.variance[self._mask]).any())
        # A jump is no speed: the next picture is expected where this one is.
        step = (here - self._last).nan_to_num(0.0)
        self._speed = step if float(step.norm(dim=1).max()) < self._apart else torch.zeros_like(step)
        self._last = here
        if motion.explained >= _FEWEST:
            self._known, self._picture = motion, image.clone()
        return motion

    def _compare_with(self, image: Tensor, mask: Mask) -> None:
        inside = torch.from_numpy(mask).to(image.device)[None, None]
        self.template = prepare_flow(image, inside, roughness=ROUGHNESS, noise=self._noise)
        value = self.template.value[0, 0].cpu().numpy()
        size = (_TEXTURE_PX, _TEXTURE_PX)
        mean, squares = (cv2.blur(one, size, borderType=cv2.BORDER_REFLECT) for one in (value, value * value))
        self._texture = np.sqrt(np.maximum(squares - mean * mean, 0))
        self._compared = mask

    def _found(self, image: Tensor, start: Tensor, warps: int, beside: "_Nearest") -> tuple[Flow, FlowMotion]:
        flow = find_flow(self.template, image, start, warps)
        displacement, residual = (one[0].permute(1, 2, 0).cpu().numpy() for one in (flow.displacement, flow.residual))
        variance = (flow.covariance[0, 0, 0] + flow.covariance[0, 1, 1]).cpu().numpy() / 2
        of_noise = LEFT_BY_NOISE["brightness"] ** 2 * float(self.template.variance)
        left = np.sqrt(np.maximum(residual[..., 0] ** 2 - of_noise, 0)) / np.maximum(_LEFT * self._texture, 1e-6)
        believed = np.isfinite(variance) & (left < 1) & beside.agrees(displacement)
        shown = np.where(believed[..., None], displacement, np.float32(np.nan)).astype(np.float32, copy=False)
        explained = float(np.where(believed, 1 - left, 0)[self._compared].mean())
        return flow, FlowMotion(
            shown, np.where(believed, variance + self._walked, np.nan).astype(np.float32), explained
        )

    def _renew(self, picture: Tensor) -> None:
        """Compares with a picture whose motion is `_known` from now on, drawn as its skin lay in the first one."""
        known = np.isfinite(self._known.variance)
        y, x = np.indices(known.shape, dtype=np.float32)
        went = np.nan_to_num(self._known.displacement)
        pixels = picture[0, 0].cpu().numpy().astype(np.float32)
        back = cv2.remap(pixels, x + went[..., 0], y + went[..., 1], cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT)
        self._walked = np.nan_to_num(self._known.variance)
        self._compare_with(torch.from_numpy(back)[None, None].to(picture.device), known)
        self.renewed, self._picture = self.renewed + 1, None


def _better(one: tuple[Flow, FlowMotion], other: tuple[Flow, FlowMotion]) -> tuple[Flow, FlowMotion]:
    return max(one, other, key=lambda found: found[1].explained)


class _Nearest:
    """The displacement of the nearest of some points (P, 2) px, at every pixel."""

    def __init__(self, places: Field, moved: Field, shape: tuple[int, ...], apart: float) -> None:
        self._apart, self._moved = apart, moved
        self._number: NDArray[np.intp] | None = None
        if len(places):
            empty = np.ones(shape, np.uint8)
            column, row = np.clip(np.rint(places).astype(int), 0, np.array(shape)[::-1] - 1).T
            empty[row, column] = 0
            # Labels count the zeros by rows; of points in one pixel, one speaks.
            _, label = cv2.distanceTransformWithLabels(
                empty, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
            )
            of_label = np.zeros(int(label.max()) + 1, np.intp)
            of_label[label[row, column]] = np.arange(len(places))
            self._number = of_label[label]

    def agrees(self, displacement: Field) -> Mask:
        """(H, W) whether a displacement (H, W, 2) px is near that of the nearest point; all where there is no point."""
        if self._number is None:
            return np.ones(displacement.shape[:2], dtype=bool)
        off = np.linalg.norm(displacement - self._moved[self._number], axis=-1)
        return np.asarray(off <= self._apart)
