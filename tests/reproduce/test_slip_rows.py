"""Tests of the rows of Terekhov & Hayward 2011 on simulated curves of d² in place of recordings."""

import dataclasses

import numpy as np
import pytest
import xarray as xr

from fingerflow.models.partial_slip import judge_trial
from fingerflow.report.slip_trials import SlipTrial
from fingerflow.reproduce import figures_of_slides
from fingerflow.reproduce.printed_row import AGREES, DIFFERS, Answer
from fingerflow.reproduce.slides import ABRUPT, EXPECTED, FADING, UNSTEADY, JudgedSlide, Slides, design_slides, kind_of
from fingerflow.reproduce.slip_rows import ROWS
from fingerflow.synthetic import LinearSlip

EQUATIONS = {f"A{k}" for k in (6, *range(12, 18), 20, 21)}


def measured(truth: LinearSlip, noise: float = 0.005) -> SlipTrial:
    """Return a trial with the d² and T/N of a slide, with noise, in place of measured values."""
    draw = np.random.default_rng(truth.camera.seed)
    area = np.array([truth.stuck_share(frame) for frame in range(truth.n_frames)])
    load = truth.tangential_force(truth.times) / truth.force
    area, load = (one + noise * draw.standard_normal(one.size) for one in (area, load))
    verdict = judge_trial(area, load, truth.times)
    values = {"stuck_ratio": area, "load_ratio": load, "normal_force": np.full(area.size, truth.force)}
    result = xr.Dataset({name: ("frame", one) for name, one in values.items()}, {"time": ("frame", truth.times)})
    return SlipTrial("slide", result, verdict, None)


@pytest.fixture(scope="module")
def slides() -> Slides:
    scene = None  # there are no frames
    return Slides(
        tuple(JudgedSlide(kind_of(one), one, measured(one), scene) for one in design_slides().values())  # type: ignore[arg-type]
    )


def answers(slides: Slides) -> dict[str, Answer]:
    without_pictures = [row for row in ROWS if row.id not in ("A8", "A11")]
    return {row.id: row.answer(slides) for row in without_pictures}


def test_the_experiment_is_that_of_the_paper() -> None:
    design = list(design_slides().values())
    kinds = [kind_of(one) for one in design]
    assert [kinds.count(kind) for kind in EXPECTED] == [4, 4, 2]
    abrupt = [one for one in design if kind_of(one) == ABRUPT]
    assert sorted(round(1000 * one.collapse) for one in abrupt) == [130, 150, 280, 310]
    assert (min(one.last for one in abrupt), max(one.last for one in abrupt)) == (0.10, 0.34)
    assert {one.frame_rate for one in design} == {60.0}
    assert {one.mm_per_px for one in design} == {0.04}


def test_outcomes_areas_and_durations_agree_with_print(slides: Slides) -> None:
    found = answers(slides)
    assert {name: found[name].verdict for name in ("A1", "A2", "A3", "A4", "A5", "A22")} == dict.fromkeys(
        ("A1", "A2", "A3", "A4", "A5", "A22"), AGREES
    )
    assert found["A2"].obtained.endswith("by the printed rule 4 with, 4 without, 2 inconclusive")


def test_equations_hold_and_misprints_do_not(slides: Slides) -> None:
    found = answers(slides)
    assert {found[name].verdict for name in EQUATIONS} == {AGREES}
    assert {found[name].verdict for name in ("A18", "A19")} == {DIFFERS}
    assert "0.500 by" in found["A18"].obtained
    assert "0.400 as printed" in found["A18"].obtained


def test_a_misjudged_slide_is_named(slides: Slides) -> None:
    first, *others = slides.slides
    wrong = dataclasses.replace(first.trial, verdict=dataclasses.replace(first.trial.verdict, outcome="diminishes"))
    one = dataclasses.replace(first, trial=wrong)
    answer = answers(Slides((one, *others)))["A2"]
    assert (answer.verdict, answer.because) == (DIFFERS, "misjudged: slide")


def test_curves_of_a_set_are_drawn_with_all_models(slides: Slides) -> None:
    draw = {one.name: one.draw for one in figures_of_slides.FIGURES}
    for name, kind in (("2b", ABRUPT), ("2c", FADING)):
        figure, said = draw[name](slides)
        assert figure is not None
        labels = figure.axes[0].get_legend_handles_labels()[1]
        assert {"Coulomb", "Tada", "equal friction", "equation 5"} <= set(labels)
        assert said.startswith(f"d² against T/N of {len(slides.of(kind))} slides")
    unsteady = Slides(tuple(slides.of(UNSTEADY)))
    assert draw["2b"](unsteady) == (None, "no slide of this set has a complete loss of adhesion")
