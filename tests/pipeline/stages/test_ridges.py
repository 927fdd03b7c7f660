"""Tests of the ridges of the skin in contact: their period, and the offset between the views."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from fingerflow.pipeline.stages.contact import view_faults
from fingerflow.pipeline.stages.preparation import ridges
from fingerflow.schema.variables import sparse_border_mm
from fingerflow.synthetic import FingerprintTexture, Press
from fingerflow.synthetic.skin_interface import Skin
from fingerflow.synthetic.texture import RidgeTexture

PRESS = Press(frame_shape=(384, 960), semi_axes=(4.5, 3.8))
SKINS = [RidgeTexture(), FingerprintTexture(pattern="loop")]


def _patch(press: Press) -> tuple[ridges.SkinPatch, np.ndarray, np.ndarray]:
    """Return the skin in contact at the end, the topography view and the transform."""
    frame, empty = press.render(299), press.empty().astype(np.float32)
    topography, contact = press.views["topography"], press.views["contact"]
    rows, columns = contact.shape
    y, x = (torch.from_numpy(one * press.mm_per_px) for one in np.mgrid[:rows, :columns])
    ellipse = press.truth.ellipse(299)
    assert ellipse is not None
    skin = ridges.skin_patch(
        contact.crop(frame[None])[0], contact.crop(empty[None])[0], ellipse.distance(x, y).numpy() > 0
    )
    assert skin is not None
    return skin, topography.crop(frame[None])[0], np.array(press.topography_to_contact)


@pytest.mark.parametrize("texture", SKINS)
def test_period_and_offset(texture: Skin) -> None:
    """The period of the skins, 0.43 to 0.53 mm, is found, and a transform that is missing or inverted shows as an
    offset of several pixels.
    """
    press = replace(PRESS, texture=texture)
    skin, topography, matrix = _patch(press)
    assert 0.4 < ridges.period_px(skin) * press.mm_per_px < 0.56
    for wrong in (np.eye(2, 3), np.linalg.inv(np.vstack([matrix, [0, 0, 1]]))[:2]):
        off = np.linalg.norm((matrix - wrong) @ [240, 192, 1.0])
        turned, offset_px = ridges.compare_views(skin, topography, wrong)
        assert turned == ""
        assert offset_px == pytest.approx(off, rel=0.5)
    mirrored = {"left to right": topography[:, ::-1], "top to bottom": topography[::-1], "": topography}
    mirrored["both ways"] = topography[::-1, ::-1]
    for turn, view in mirrored.items():
        assert ridges.compare_views(skin, view, matrix) == (turn, 0)
    # Views of different skin, or without skin, give no offset.
    noise = np.random.default_rng(0).normal(size=topography.shape)
    for view in (noise, np.full_like(topography, 90)):
        assert ridges.compare_views(skin, view, matrix) == ("", 0)


@pytest.mark.parametrize("width", [0.45, 0.55, 0.65])
def test_sweat_is_told_from_wide_ridges(width: float) -> None:
    """Ridges of a share `width` of the period, which varies by a quarter; sweat fills valleys in patches of 0.6 mm."""
    y, x = np.mgrid[:400, :400]
    phase = (x + 12 * np.sin(y / 40) + 15 * np.sin(x / 60)) / 15 % 1
    touching, sweat = phase < width, np.zeros((400, 400), bool)
    for right, down in np.random.default_rng(0).uniform(0, 400, (150, 2)):
        sweat |= np.hypot(x - right, y - down) < 10
    assert not [*view_faults.check_sweat(touching, 15.0)]
    assert "sweat" in next(view_faults.check_sweat(touching | sweat, 15.0))


@pytest.mark.parametrize(("share", "border_mm"), [(0.17, 0.15), (0.2, 0.075), (0.3, 0)])
def test_sparse_ridges_leave_the_border_uncertain(share: float, border_mm: float) -> None:
    assert sparse_border_mm(np.array([share]), np.ones(1)) == pytest.approx(border_mm)
