"""Tests of the figures of the supplement: panels that a table supports, reasons for the others, legible labels."""

from collections.abc import Callable
from itertools import combinations

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from fingerflow.models.observer import Trials, read_trials
from fingerflow.plot.captions import caption_of
from fingerflow.plot.figure_files import settle
from fingerflow.report.sheet import Sheet
from fingerflow.report.supplement import FIGURES, supplement_sheet
from fingerflow.report.trial_metrics import METRICS

Command = Callable[..., int]
Printed = pytest.CaptureFixture[str]
pytestmark = pytest.mark.long
_TOUCH_PX = 1.5  # at 100 dpi: labels may overlap by less than half a millimetre


def table(columns: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Return the columns of a table of 8 participants, 4 of them with softer skin, and 4 amplitudes."""
    draw = np.random.default_rng(0)
    who, amplitude, trial = map(np.ravel, np.meshgrid(range(8), (0.0, 1.0, 2.0, 3.0), range(6), indexing="ij"))
    answer = draw.random(who.size) < 0.5 + 0.16 * amplitude
    level = 0.01 + 0.02 * (who >= 4) + 0.002 * amplitude + 0.001 * answer
    found = {"participant": who, "trial": trial, "condition": amplitude, "answer": answer}
    return found | {name: level * (1 + 0.2 * draw.random(who.size)) for name in columns}


@pytest.fixture(scope="module")
def trials() -> Trials:
    return read_trials(table(METRICS))


def test_a_table_brings_the_figures_of_its_columns_and_the_others_say_why() -> None:
    trials = read_trials(table(("divergence", "curl", "strain", "global_displacement", "force_rate")))
    sheets = {name: supplement_sheet(name, trials) for name in FIGURES}
    assert sheets["S1"].missing() == [
        "C, E need pictures and series of recordings, which no table of trials holds",
        "D needs values of gross_contact_area in the table of trials",
        "F needs values of real_contact_area in the table of trials",
    ]
    assert sheets["S11"].missing() == [
        "the rest needs values of force_angle, strain_rate, strain_energy, real_contact_area in the table of trials"
    ]
    letters = {name: [panel.letter for panel in sheet.panels] for name, sheet in sheets.items() if sheet.panels}
    assert letters == {
        "S5": ["H", "I"], "S7": ["A", "C"], "S8": ["G", "H"], "S11": ["A", "B", "C, d'", "C, AUC"],
        "S12": ["A", "B, stiffer skin", "B, softer skin", "C"], "S13": ["C"],
    }  # fmt: skip
    metrics = sheets["S11"].figure().axes[2].get_yticklabels()
    assert [label.get_text() for label in metrics] == ["divergence", "global displacement", "force rate"]


def test_differences_are_taken_where_the_caption_has_them() -> None:
    found = read_trials(table(("divergence", "force_angle", "force_angle_difference")))
    axes = supplement_sheet("S7", found).figure().axes
    assert [one.get_xlabel() for one in axes] == ["vibration amplitude (µm)", "median peak force angle difference (°)"]


def test_answers_of_one_kind_and_empty_columns_are_drawn_or_said() -> None:
    columns = table(("divergence", "curl"))
    columns["answer"][:], columns["curl"][:] = True, np.nan
    found = read_trials(columns)
    assert "both are needed" in supplement_sheet("S11", found).figure().axes[0].get_title()
    supplement_sheet("S12", found).figure()
    assert supplement_sheet("S13", found).missing()[-1] == "C needs values of curl in the table of trials"


def test_panels_have_letters_without_gaps_and_the_caption_names_those_in_print(trials: Trials) -> None:
    figure = supplement_sheet("S8", trials).figure()
    assert [part._suptitle.get_text() for part in figure.subfigs] == list("ABC")
    heading, *panels = caption_of(figure).splitlines()
    assert heading == "Figure S8: strain of the surface."
    assert [line.partition(").")[0] for line in panels] == ["A (as S8 G", "B (as S8 H", "C (as S8 I"]
    assert all("n = " in line for line in panels)
    assert Sheet("S1", (), (("A", "x"), ("C", "y"), ("B", "x"))).missing() == ["A, B need x", "C needs y"]


def labels(figure: Figure) -> list[Text]:
    """Return the visible titles, axis labels, tick labels and panel letters."""
    found = [part._suptitle for part in figure.subfigs]
    for axes in figure.axes:
        found += [axes.title, axes.xaxis.label, axes.yaxis.label]
        for axis, limits in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
            low, high = sorted(limits)
            ticks = zip(axis.get_ticklocs(), axis.get_ticklabels(), strict=False)
            found += [text for place, text in ticks if low <= place <= high]
    return [text for text in found if text is not None and text.get_visible() and text.get_text()]


def overlap(first: Bbox, second: Bbox) -> float:
    """Return the overlap of two boxes in px, in the direction in which they overlap less."""
    wide = min(first.x1, second.x1) - max(first.x0, second.x0)
    return min(wide, min(first.y1, second.y1) - max(first.y0, second.y0))


@pytest.mark.parametrize(("name", "width"), [*((name, 85) for name in FIGURES), ("S5", 170), ("S12", 170)])
def test_labels_are_whole_and_apart(name: str, width: int, trials: Trials) -> None:
    figure = supplement_sheet(name, trials).figure(width)
    settle(figure)
    figure.draw_without_rendering()
    texts = labels(figure)
    boxes = [text.get_window_extent() for text in texts]
    legends = [one.get_window_extent() for one in (axes.get_legend() for axes in figure.axes) if one is not None]
    assert len(texts) > 5
    assert all(text.get_fontsize() >= 7 for text in texts)
    for box in (*boxes, *legends):
        assert max(-box.x0, -box.y0, box.x1 - figure.bbox.width, box.y1 - figure.bbox.height) < _TOUCH_PX, name
    for (one, first), (other, second) in combinations(zip(texts, boxes, strict=True), 2):
        assert overlap(first, second) < _TOUCH_PX, f"{one.get_text()!r} lies on {other.get_text()!r}"
