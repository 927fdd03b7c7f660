"""The fused path from counts to touching pixels: its ops one by one bit for bit, and OpenCV's way."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
import torch
from kernel_images import CONTENTS, SHAPES, images

from fingerflow import kernels
from fingerflow.ops.contact_classes import ContactClasses, contact_classes

pytestmark = pytest.mark.skipif(not kernels.serve(), reason="the compiled kernels were not built or are turned off")

Portable = Callable[[Callable[[], object]], ContactClasses]


def assert_same(ours: ContactClasses, theirs: ContactClasses) -> None:
    for name, one, other in zip(ContactClasses._fields[:-1], ours, theirs, strict=False):
        assert one.dtype == other.dtype, name
        assert torch.equal(one.nan_to_num(-1), other.nan_to_num(-1)), name
    for one, other in zip(ours.classes, theirs.classes, strict=True):
        assert one.shape == other.shape
        assert torch.equal(one.nan_to_num(-1), other.nan_to_num(-1))


@pytest.mark.parametrize("size", [1, 3, 9, 13])
@pytest.mark.parametrize("content", CONTENTS)
@pytest.mark.parametrize("shape", SHAPES)
def test_same_as_the_ops(portable: Portable, shape: tuple[int, int, int], content: str, size: int) -> None:
    frames = images(shape, torch.uint8, content)
    reference = images((1, *shape[1:]), torch.float32, "random", seed=5)
    assert_same(
        contact_classes(frames, reference, median_px=size),
        portable(lambda: contact_classes(frames, reference, median_px=size)),
    )


def test_dark_and_views(portable: Portable) -> None:
    both = images((3, 40, 200), torch.uint16, "random", highest=4095)
    frames, reference, dark = both[..., :100], both[..., 100:], both[:1, ..., 50:150] / 64
    assert_same(contact_classes(frames, reference, dark), portable(lambda: contact_classes(frames, reference, dark)))


def test_equals_opencv_on_a_drawn_contact() -> None:
    y, x = np.mgrid[:120, :160]
    rng = np.random.default_rng(1)
    ridges = (np.hypot(x - 80, y - 60) < 45) & ((x + y // 2) % 9 < 5)
    frame = np.clip(np.where(ridges, 90, 180) + rng.normal(0, 4, ridges.shape), 0, 255).astype(np.uint8)
    ours = contact_classes(torch.from_numpy(frame)[None, None], torch.full((1, 1, 120, 160), 200.0), median_px=5)
    lost = 1 - frame.astype(np.float32) / np.float32(200)
    levels = np.clip(np.rint((lost + np.float32(0.25)) * 204), 0, 255).astype(np.uint8)
    smooth = cv2.medianBlur(levels, 5)
    threshold, touching = cv2.threshold(smooth, 0, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    assert ours.threshold.item() == threshold
    assert np.array_equal(ours.touching[0, 0], touching.astype(bool))
    assert 1000 < ours.touching.sum() < 5000


def test_refuses_what_does_not_fit() -> None:
    frames = torch.zeros(2, 1, 8, 8)
    with pytest.raises(ValueError, match="reference has shape"):
        contact_classes(frames, frames[..., :7])
    with pytest.raises(ValueError, match="4 x 4"):
        contact_classes(frames, frames, median_px=4)
    with pytest.raises(ValueError, match="33 was asked for"):
        kernels.contact_classes(frames, frames, None, 0.05, -0.25, 204.0, 33)
