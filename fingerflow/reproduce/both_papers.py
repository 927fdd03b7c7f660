"""Run of the reproduction: simulate, measure, compare with print, draw, write the page."""

from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from fingerflow.reproduce import figures_of_slides, slip_rows
from fingerflow.reproduce.paper_page import TITLES, PaperResults, write_page, write_results
from fingerflow.reproduce.slides import record_and_measure

_ABOUT_SLIDES = (
    "Ten slides at 60 Hz with a pixel of 40 µm: in four the stick region collapses at the printed sizes and "
    "durations, in four it shrinks to nothing, in two the tangential force swings. Frictions, forces, contact sizes "
    "and skin differ from slide to slide. Before a collapse d² falls in a straight line with T/N, as the paper saw no "
    "parabola."
)


def reproduce(folder: Path, papers: Sequence[str] = tuple(TITLES), quick: bool = False, progress: bool = True) -> Path:
    """Reproduce papers in a folder, and return the page of all that were reproduced there.

    Recordings that exist and trials that are measured are kept.

    Args:
        folder: created if missing; recordings and results are in `slip` and `press`, the page is in `page`.
        papers: names in `TITLES`.
        quick: a small study of presses in place of the whole.
        progress: show bars.

    Raises FingerflowError if a file cannot be written.
    """
    page = folder / "page"
    for paper in papers:
        source = record_and_measure(folder / paper, progress)
        rows = [row.answer(source) for row in slip_rows.ROWS]
        figures = tqdm(figures_of_slides.FIGURES, desc="figures", disable=not progress)
        drawn = [one.write(source, page / paper) for one in figures]
        write_results(PaperResults(paper, _ABOUT_SLIDES, rows, drawn), page)
    return write_page(page)
