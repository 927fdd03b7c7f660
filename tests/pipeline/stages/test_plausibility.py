"""Tests of the checks of settings against data: each warning from its numbers, and in a scene that causes it."""

from pathlib import Path

import numpy as np
import pytest

from fingerflow import process
from fingerflow.engines.engine import Array
from fingerflow.errors import FingerflowError
from fingerflow.pipeline.stages.preparation import plausibility
from fingerflow.report import write_report
from fingerflow.tracker import area_steps
from fingerflow.tracker.faint_rim import check_faint_rim
from tests.pipeline.stages.conftest import Change
from tests.small_trials import TINY_PRESS, warnings_of

HALF = [[50, 0], [119, 0], [119, 95], [50, 95]]  # px of the contact view, which contain a part of the contact


def test_what_is_plausible_says_nothing() -> None:
    """Forces with an offset or none, the slowest growth of a real contact, and a slide are plausible."""
    areas = np.array([0.0, 1, 2, np.nan, 3])
    force, gross, nothing = np.linspace(0, 5, 40) ** 2 / 5, np.linspace(0, 80, 40), np.full(40, np.nan)
    messages = [plausibility.check_areas(areas, 2 * areas, 8, 0), plausibility.check_growth(force, force**0.1)]
    messages += [plausibility.check_areas(nothing, nothing, 8, 0), plausibility.check_onset(force, nothing, 0)]
    messages += [area_steps.check_beginning(area, 0) for area in (gross, np.full(40, 66.0), nothing)]
    messages += [plausibility.check_background(0.004, 0.88, 0), plausibility.check_views("", 0.0, 0.03)]
    messages += [plausibility.check_seeded_region(0.04), plausibility.check_gauge(1.6, 7.4)]
    messages.append(plausibility.check_growth(force[8:16], np.full(8, gross[8])))  # of few frames none is the end
    # A bright spot, an even picture below full scale, and dark pictures are not saturated.
    spot, even = np.arange(1000) % 254, np.full(1000, 200)
    spot[:9] = 255
    messages += [plausibility.check_clipped("contact", counts) for counts in (spot, even, 0 * even, even % 1)]
    for normal in (force, force + 0.02, 0.1 * force, nothing):
        messages += [plausibility.check_force(normal), plausibility.check_pressure(normal, gross)]
        messages += [plausibility.check_onset(normal, gross, 0), plausibility.check_growth(normal, gross)]
        messages += [area_steps.check_missing_frames(gross, normal, 0)]
    # A contact that lets go, or that chatters as it begins, touches once; a noisy, steady force is below its limit.
    chatter = np.concatenate([[0, 1, 0], gross, gross[::-1], [0, 0]])
    messages += [area_steps.second_touches(area).tolist() for area in (gross, chatter, nothing, nothing[:1])]
    messages += [plausibility.check_growth_time(area) for area in (gross, gross[9:], chatter, nothing)]
    noisy = np.round(np.minimum(np.arange(4000) / 800, 3) + np.random.default_rng(0).normal(0, 0.005, 4000), 3)
    for one in (noisy, np.minimum(force, 3), nothing, nothing[:1], 0.5 * np.sin(np.arange(400) / 8)):
        messages += [plausibility.check_saturation(one, "normal_force"), plausibility.check_spikes(one, "normal_force")]
    messages.append(plausibility.check_tracking(np.ones(40), np.full(40, 1 / 700), 0))  # one at the edge of slip
    messages += [plausibility.check_load_ratio(np.full(40, ratio), force) for ratio in (0, -5.0, np.nan)]
    assert not any(map(list, messages))


def test_sentences_name_the_frames_and_the_numbers() -> None:
    real, gross = np.array([0.0, 5, 5, 5]), np.array([0.0, 6, 4, 3])
    (more,) = plausibility.check_areas(real, gross, 1, 10)
    (gauge,) = plausibility.check_gauge(2.6, 7.4)
    # 7.4 mm / 3 = 2.467 mm: the nearest, 2.5 mm, is warned of too.
    assert gauge.endswith("smoothed by more than their deviations state. Take 2.46 mm or less")
    for radius, width, narrow in ((6, 0.08, True), (7, 0.2, False)):
        (rim,) = check_faint_rim(width, 60.0, 0.2, radius, 13.5)
        assert ("gross_radius_px (6) to half the ridge distance, 7," in rim) == narrow
    assert not [*check_faint_rim(0.08, 60.0, 0.2, 7, 13.5)]
    assert "27% of the contact lies outside the region" in next(plausibility.check_seeded_region(0.27))
    assert "in 2 frames, the first is 12," in more
    assert "(5 and 4 mm²)" in more
    for level in (255, 1023, 65535, 4095 << 4):
        (saturated,) = plausibility.check_clipped("topography", np.minimum(np.arange(1000) * level // 950, level))
        assert f"5% of the topography view is saturated: its grey level is {level}" in saturated
    # An unusable frame between two frames does not hide a jump.
    (jump,) = area_steps.check_light_steps(np.array([3.0, np.nan, 60, 61]), 100.0, 0)
    assert "jumps from 3 to 60 mm² between frames 0 and 2" in jump
    assert area_steps.second_touches(np.array([0, 2.0, 3, 4, 0, np.nan, 0, 3, 4])).tolist() == [7]
    (quick,) = plausibility.check_growth_time(np.array([0, 0, 30, 60, 75, 79, 80.0]))
    assert "grows to its size in 2 frames" in quick
    ramp = np.arange(4000) / 800 + np.random.default_rng(0).normal(0, 0.005, 4000)
    for clipped in (np.minimum(ramp, 3), np.maximum(-ramp, -3), np.append(np.minimum(ramp, 3), np.nan)):
        (limit,) = plausibility.check_saturation(clipped, "normal_force")
        assert "of 4000 samples of the normal force are 3 N, none is larger" in limit
    (lost,) = plausibility.check_tracking(np.array([1, 0.4, 0.1]), np.zeros(3), 5)
    assert "in 2 frames, the first is 6 (40%)" in lost


def test_a_contradiction_between_force_and_contact_is_said() -> None:
    """Warnings name forces in wrong units, forces out of step with the frames, and missing frames."""
    force, gross = np.linspace(0, 5, 40) ** 2 / 5, np.linspace(0, 80, 40)
    for normal, value in ((1000 * force, "6.25e+04 kPa"), (102 * force, "6.38e+03 kPa"), (force / 1000, "0.0625 kPa")):
        (said,) = plausibility.check_pressure(normal, gross)
        assert value in said
    assert "reaches 510 N" in next(plausibility.check_force(102 * force))
    late, early = np.concatenate([np.zeros(9), force[:-9]]), np.concatenate([force[9:], np.full(9, 5.0)])
    (said,) = plausibility.check_onset(late, gross, 100)
    assert "the contact has 21 of its 80 mm² in frame 110, where the normal force is 0.0033 of 3 N" in said
    (said,) = plausibility.check_onset(early, gross, 100)
    assert "the normal force is 0.27 N in frame 100, where nothing touches (in 1 frames)" in said
    (said,) = plausibility.check_growth(force, np.minimum(gross, 60))
    assert "and the contact no longer grows (60 mm²)" in said
    (said,) = plausibility.check_spikes(np.where(np.arange(40) == 20, -50, force), "normal_force")
    assert "a single sample of the normal force lies 51.2 N from both beside it" in said
    (said,) = plausibility.check_load_ratio(np.full(40, -30.0), force)
    assert "the tangential force is 30 times the normal one" in said
    cut = np.delete(np.linspace(0, 80, 80), np.s_[30:50])
    (said,) = area_steps.check_missing_frames(cut, None, 5)
    assert "steps from 29.4 to 50.6 mm² between frames 34 and 35, 21 times as far" in said
    # If the force has the same step, the step is real.
    assert not [*area_steps.check_missing_frames(cut, cut / 16, 5)]
    (said,) = area_steps.check_beginning(gross[10:], 10)
    assert "20.5 of 80 mm² touch in frame 10" in said


def test_pictures_that_contradict_the_settings_are_said(changed: Change, frames: Array) -> None:
    """A background that shows a finger is named. A permanent drop of the light to 60 % between two frames cannot be
    told from contact; a warning names the frames.
    """
    fixed = {'threshold = "reference_frame"': "threshold = 0.27"}
    finger = process(changed(fixed, empty=frames[3]), ["gross_contact_area"])
    assert "background.frames is darker than frame 0 in " in warnings_of(finger)
    for first in ("# first_frame = 0", "first_frame = 2", "first_frame = 5"):
        with pytest.raises(FingerflowError, match="the background is the recording itself"):
            process(changed({"# first_frame = 0": first}, empty=np.asfortranarray(frames)))
    for old, new, said in (
        ("columns = [120, 240]", "columns = [170, 240]", "the edge of the contact view cuts off 23% of the border"),
        ("[views.contact]", f"[views.contact]\nregion = {{polygon = {HALF}}}", "or the border of views.contact.region"),
    ):
        assert said in warnings_of(process(changed({old: new}), ["gross_contact_area"]))
    same = process(changed({"columns = [0, 120]": "columns = [120, 240]"}), ["position"])
    assert "views.contact and views.topography are equal" in warnings_of(same)
    dim = frames.copy()
    dim[4:, :, 120:] = (0.6 * dim[4:, :, 120:]).astype(dim.dtype)
    warnings = warnings_of(process(changed(fixed, frames=dim), ["gross_contact_area"]))
    assert "mm² between frames 3 and 4: more likely the light has changed" in warnings


@pytest.mark.parametrize("width_px", [20, 30, 40])
def test_the_centre_holds_a_rim_that_is_pale_on_one_side(
    width_px: int, press: Path, frames: Array, changed: Change
) -> None:
    glass, share = np.load(press / "empty.npy").astype(float), np.ones(240)
    share[120:] = np.clip((np.arange(120) - 25) / width_px, 0.1, 1)
    pale = (glass - (glass - frames) * share).clip(0, 255).astype(np.uint8)
    result = process(changed(frames=pale), ["ellipse_center", "ellipse_center_std"])
    error = np.abs(result["ellipse_center"].values[-1] - TINY_PRESS.contact_centre)
    assert (error < 2.5 * result["ellipse_center_std"].values[-1]).all()


def test_deviations_hold_impulses_and_too_narrow_an_average(changed: Change, frames: Array) -> None:
    peppered = frames.copy()
    peppered[:, ::7, 120::7] = 0
    narrow = {"median_px = 3": "median_px = 1", "gross_radius_px = 8": "gross_radius_px = 5"}
    result = process(changed(narrow, frames=peppered), ["gross_contact_area_std", "real_contact_area_std"])
    for name in ("gross_contact_area", "real_contact_area"):
        error = result[name].values[-1] - getattr(TINY_PRESS.truth, f"{name}_mm2")(7)
        assert abs(error) < 2 * result[f"{name}_std"].values[-1], name
    assert result["gross_contact_area"].attrs["faint_rim_mm"] > 0.05  # real prints of 13 px a ridge are off by that


def test_points_that_are_all_lost_have_no_energy(changed: Change, frames: Array) -> None:
    """The energy is NaN, not 0 mJ, if all points are lost, and 0 if nothing touches."""
    blank = frames.copy()
    blank[5:, :, :120] = 90
    result = process(changed(frames=blank))
    assert (result["gross_contact_area"].values[5:] > 1).all()
    for name in ("strain_energy", "median_divergence", "global_displacement"):
        assert np.isnan(result[name].values[5:]).all(), name
    assert "less than half of the points are tracked in 3 frames, the first is 5 (0%)" in warnings_of(result)
    released = np.concatenate([frames, frames[::-1]])
    result = process(changed({"trigger_frame = 1 ": ""}, frames=released, forces=False))
    without = result["gross_contact_area"].values == 0
    assert without[-1]
    assert (result["strain_energy"].values[without] == 0).all()
    assert "touches it again" not in warnings_of(result)


def test_a_second_touch_is_said_unless_displacement_counts_from_a_frame(changed: Change, frames: Array) -> None:
    again = np.concatenate([frames, frames[::-1], frames]) ^ np.arange(24, dtype=np.uint8)[:, None, None] % 2
    first = {"trigger_frame = 1 ": ""}
    result = process(changed(first, frames=again, forces=False), ["displacement"])
    assert "touches it again in frame 18" in warnings_of(result)
    before, after = (np.isfinite(result["displacement"].values[k, :, 0]).sum() for k in (7, -1))
    assert after < 0.1 * before  # points on the border touch in the second alone
    since = first | {'reference = "onset"': 'reference = "first_frame"'}
    result = process(changed(since, frames=again, forces=False), ["displacement"])
    assert "touches it again" not in warnings_of(result)


def test_a_report_of_another_recording_is_refused(changed: Change, frames: Array, press: Path, tmp_path: Path) -> None:
    """A result of another press of equal size and length is refused; the camera noise distinguishes them."""
    other = changed(frames=frames + np.random.default_rng(0).integers(0, 2, frames.shape, np.uint8))
    result = process(press / "scene.toml", ["real_contact_area"])
    with pytest.raises(FingerflowError, match=r"frames\.npy: the result is not of these frames .* from .*"):
        write_report(result, other, tmp_path)
    assert not (tmp_path / "report.html").exists()
