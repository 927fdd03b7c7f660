"""Tests that figures of the supplement are legible in one and two columns: labels do not overlap and are
not cut off.
"""

from itertools import combinations

import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from fingerflow.plot.figure_files import settle
from fingerflow.report.simulated_presses import simulate_presses
from fingerflow.report.supplement import FIGURES, Sources, sources
from fingerflow.report.trial_metrics import METRICS
from fingerflow.report.trials_file import load_trials
from fingerflow.report.tribometer import read_tribometer
from tests.report import test_supplement, test_tribometer

pytestmark = pytest.mark.long
_TOUCH_PX = 1.5  # at 100 dpi: labels may overlap by less than half a millimetre


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Sources:
    folder = tmp_path_factory.mktemp("tables")
    trials = load_trials(test_supplement.table(folder / "t.csv", METRICS))
    trace = read_tribometer(test_tribometer.written(folder), test_tribometer.COLUMNS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sources, "simulate_presses", lambda: simulate_presses(times=21, elements=101))
        found = Sources(trials=trials, tribometer=trace)
        assert found.presses.friction
    return found


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


@pytest.mark.parametrize("width", [85, 180])
@pytest.mark.parametrize("name", FIGURES)
def test_labels_are_whole_and_apart(name: str, width: int, inputs: Sources) -> None:
    figure = FIGURES[name](inputs).figure(width)
    settle(figure)
    figure.draw_without_rendering()
    texts = labels(figure)
    boxes = [text.get_window_extent() for text in texts]
    assert len(texts) > 5
    assert all(text.get_fontsize() >= 7 for text in texts)
    for text, box in zip(texts, boxes, strict=True):
        outside = max(-box.x0, -box.y0, box.x1 - figure.bbox.width, box.y1 - figure.bbox.height)
        assert outside < _TOUCH_PX, f"{text.get_text()!r} is cut by {outside:.1f} px"
    for (one, first), (other, second) in combinations(zip(texts, boxes, strict=True), 2):
        assert overlap(first, second) < _TOUCH_PX, f"{one.get_text()!r} lies on {other.get_text()!r}"
    for legend in filter(None, (axes.get_legend() for axes in figure.axes)):
        box = legend.get_window_extent()
        assert max(-box.x0, -box.y0, box.x1 - figure.bbox.width, box.y1 - figure.bbox.height) < _TOUCH_PX
