"""Tests of the segmentation steps as printed in the paper, against OpenCV and against the default area."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from fingerflow import load_scene, process
from fingerflow.schema.scene import Scene


@pytest.fixture(scope="module")
def scene(press: Path) -> Scene:
    return load_scene(press / "scene.toml")


def test_areas_are_those_of_opencv(scene: Scene) -> None:
    """Areas equal those of median, Otsu's threshold and erosion by OpenCV on the contact signal in one byte; the frame
    of first contact shows only glass. A frame without contact has none.
    """
    names = ["printed_real_contact_area", "printed_eroded_contact_area", "real_contact_area"]
    found = process(scene, names)
    area = found["real_contact_area"].values
    np.testing.assert_array_equal(np.isnan(found["printed_real_contact_area"]), area == 0)
    frames, dark, empty = (
        np.load(path).astype(float) for path in (scene.recording.frames, scene.background.dark, scene.background.frames)
    )
    view = scene.views.contact
    frames, dark, empty = view.crop(frames), view.crop(dark).mean(0), view.crop(empty).mean(0)
    lit = empty - dark > 0.06 * np.quantile(empty - dark, 0.99)
    quotient = np.where(lit, (frames - dark) / np.where(lit, empty - dark, 1), 1)
    first = int(np.argmax(area > 0))
    for frame in np.flatnonzero(area > 1)[::5]:
        signal = quotient[first] - quotient[frame]
        levels = np.clip(np.rint(255 * (signal + 0.25) / 1.25), 0, 255).astype(np.uint8)
        _, mask = cv2.threshold(cv2.medianBlur(levels, 9), 0, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
        cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
        size = scene.calibration.mm_per_px**2
        expected = mask.sum() * size, cv2.erode(mask, cross).sum() * size
        # Rounding of the quotient by one level changes single pixels.
        np.testing.assert_allclose(
            [float(found[name][frame]) for name in names[:2]], expected, rtol=2e-3, atol=8 * size
        )
