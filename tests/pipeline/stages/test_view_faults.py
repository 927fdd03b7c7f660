"""Tests of the checks for faults in a contact view beside the finger, each with and without its fault."""

import numpy as np
import pytest

from fingerflow.pipeline.stages.contact import view_faults

PERIOD = 14.0
Y, X = np.mgrid[:240, :320].astype(float)
REGION = np.hypot((X - 160) / 80, (Y - 120) / 60) < 1
LIGHT = 100 * np.clip((115 - np.hypot(X - 160, Y - 120)) / 6, 0.02, 1) * (1 - 0.1 * X / 320)
RIDGES = REGION & (np.sin(2 * np.pi * (X + 0.4 * Y) / PERIOD) > 0)
FRAME = LIGHT * np.where(RIDGES, 0.5, 1.0)
SHADE = 1 - 0.35 * np.exp(-np.maximum(np.hypot((X - 160) / 80, (Y - 120) / 60) - 1, 0) * 70 / 12)


def test_a_contact_on_lit_glass_has_no_fault() -> None:
    assert view_faults.check_unlit_glass(REGION, LIGHT, 8) == []
    assert view_faults.check_sweat(RIDGES, PERIOD) == view_faults.check_sweat(REGION, PERIOD) == []
    assert view_faults.check_shadow(FRAME / LIGHT, REGION, PERIOD) == []
    assert view_faults.check_background_lines(LIGHT) == []
    assert view_faults.check_moved_glass([(0, FRAME)], LIGHT, REGION) == []
    assert view_faults.check_strip(np.array([[3.0, 2.0], [np.nan, np.nan]]), np.array([18.0, 0.0]), 0) == []
    assert view_faults.described(LIGHT, LIGHT, 0) == ""


def test_faults_are_said() -> None:
    """Dark glass beside the contact, a strip that is no fingertip, sweat in valleys, the shadow of a finger, and lines
    of the background without light.
    """
    dark, torn = np.where(X > 200, 0, LIGHT), np.where((Y < 100) | (Y >= 130), LIGHT, 0)
    assert "without light along" in view_faults.check_unlit_glass(REGION & (X <= 200), dark, 8)[0]
    axes, gross = np.array([[np.nan, np.nan], [6.0, 0.2]]), np.array([np.nan, 2.0])
    assert "in frame 8" in view_faults.check_strip(axes, gross, 7)[0]
    assert "sweat" in view_faults.check_sweat(RIDGES | (np.hypot(X - 150, Y - 120) < 25), PERIOD)[0]
    assert "shadow" in view_faults.check_shadow(FRAME / LIGHT * SHADE, REGION, PERIOD)[0]
    assert "from row 100 " in view_faults.check_background_lines(torn)[0]


@pytest.mark.parametrize("shift", [(5, 0), (-3, 4)])
def test_light_that_has_moved(shift: tuple[int, int]) -> None:
    frame = np.roll(LIGHT, shift, (1, 0)) * np.where(RIDGES, 0.5, 1.0)
    said = view_faults.check_moved_glass([(3, FRAME), (12, frame)], LIGHT, REGION)[0]
    assert f"frame 12 ({shift[0]:+d} px along x, {shift[1]:+d} along y)" in said


def test_what_a_frame_without_a_finger_shows() -> None:
    for light, text in (
        (LIGHT * (1 - 0.15 * X / 320), "falls by 15% across the view"),
        (LIGHT * np.where(np.abs(X - 100) < 12, 0.5, 1), "darker than the rest"),
        (0.8 * LIGHT, "80% of the background's light"),
    ):
        assert text in view_faults.described(light, LIGHT, 0)
