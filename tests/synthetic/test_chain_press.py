"""Tests of a press whose skin moves as the skin chain does: truth, and the chain's divergence measured from frames."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from bench.papers.chain import SimulatedPresses, energy_mj, strain_percent
from bench.suites.friction_loop import QUICK_PRESS, inner_divergence, median_divergence
from fingerflow import process
from fingerflow.models.skin_onset import since_onset
from fingerflow.synthetic import ChainPress, rebuild_scene, write_recording

pytestmark = pytest.mark.long

FRICTIONS = (0.2, 1.0)


@pytest.mark.parametrize("friction", FRICTIONS)
def test_truth_is_what_the_chain_says_of_itself(friction: float) -> None:
    """The truth equals the field of the chain to 0.3 um/mm RMS and 1 um/mm at most, up to 0.1 mm from the edge:
    differences between neighbours of the chain are as large. The edge of the contact agrees to 0.01 mm, a third of an
    element.
    """
    press = ChainPress(friction=friction, n_frames=5, frame_rate=4 / 0.9, frames_before_trigger=0, contact_time=0.0)
    seen = since_onset(press.chain)
    for frame, row in ((1, 64), (2, 128), (3, 192), (4, 256)):
        ellipse = press.truth.ellipse(frame)
        assert ellipse is not None
        radius = ellipse.semi_axes[0]
        assert radius == pytest.approx(1e3 * (seen.contact_area[row].item() / np.pi) ** 0.5, abs=0.01)
        away = np.linspace(0.1, radius - 0.1, 40)
        turn = 0.7
        places = away[:, None] * [np.cos(turn), np.sin(turn)] + press.contact_centre
        gradient = 1e3 * press.truth.gradient(press.truth.material(places, frame), frame)
        known = seen.radius[row].isfinite()
        chain = (1e3 * values[row][known].numpy() for values in (seen.radius, seen.divergence_field))
        error = gradient[:, 0, 0] + gradient[:, 1, 1] - np.interp(away, *chain)
        assert np.sqrt((error**2).mean()) < 0.3
        assert np.abs(error).max() < 1.0
        medians = press.truth.medians(frame)
        assert 1e3 * medians.divergence == pytest.approx(1e3 * seen.area_median[row].item(), abs=0.7)
        assert abs(medians.curl) < 1e-6


def test_the_divergence_of_the_chain_comes_back_from_the_pictures(tmp_path: Path) -> None:
    """The inner divergence is measured to 1.2 um/mm in every frame from 5 mm² on and 0.6 RMS, for each friction and for
    their difference of 3.8; `median_divergence` to 1.1 um/mm RMS and 2.2 in single frames.
    """
    errors: list[list[np.ndarray]] = [[], []]
    for friction in FRICTIONS:
        press = replace(QUICK_PRESS, friction=friction)
        write_recording(tmp_path / f"{friction:g}", press)
        result = process(tmp_path / f"{friction:g}" / "scene.toml")
        for kind, of in enumerate((inner_divergence, median_divergence)):
            measured, chain = of(press, result)
            errors[kind].append(measured - chain)
    for some, usual, most in zip(errors, (0.6, 1.1), (1.2, 2.2), strict=True):
        for error in (*some, some[0] - some[1]):
            assert np.isfinite(error).sum() > 40
            assert np.sqrt(np.nanmean(error**2)) < usual
            assert np.nanmax(np.abs(error)) < most


@pytest.mark.parametrize("friction", FRICTIONS)
def test_the_printed_analysis_of_the_pictures_is_that_of_the_chain(tmp_path: Path, friction: float) -> None:
    """A scene with the profile of the paper gives divergence since onset in the contact dilated by 8 px, and strain and
    energy since the first frame with contact, as the rows of the paper have them from the chain.
    """
    press = replace(QUICK_PRESS, friction=friction, mm_per_px=0.0325)
    write_recording(tmp_path / "press", press)
    scene = tmp_path / "press" / "scene.toml"
    scene.write_text('profile = "willemet_2021"\n' + scene.read_text(encoding="utf-8"), encoding="utf-8")
    result = process(scene)
    force = press.interpolate_chain(press.chain.normal_force.sum(-1))
    presses = SimulatedPresses((friction,), force, force, press.chain)
    for name, truth, error in (
        ("median_divergence", since_onset(press.chain, 8 * press.mm_per_px / 1e3).area_median, 1.2e-3),
        ("printed_strain", strain_percent(presses.printed) / 100, 8e-4),
        ("printed_strain_energy", energy_mj(presses.printed), 6e-4),
    ):
        measured = result[name].values.reshape(force.size, -1)[:, 0][force > 0.7]
        chain = press.interpolate_chain(torch.as_tensor(truth).reshape(-1))[force > 0.7]
        assert np.sqrt(np.square(measured - chain).mean()) < error
        assert measured[-1] > 3 * error


def test_a_recording_rebuilds_its_chain(tmp_path: Path) -> None:
    press = replace(QUICK_PRESS, friction=0.05, n_frames=4, elements=101)
    write_recording(tmp_path / "press", press)
    again = rebuild_scene(tmp_path / "press")
    assert again == press
    np.testing.assert_array_equal(again.render(3), press.render(3))
