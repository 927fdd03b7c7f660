"""Run the reproduction: simulate recordings, measure them, compare with the printed results, write figures and page."""

from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from fingerflow.reproduce import figures_of_presses, figures_of_slides, method_rows, press_rows, slip_rows
from fingerflow.reproduce.drawn_figure import PrintedFigure, PrintedMovie
from fingerflow.reproduce.paper_page import TITLES, write_page, write_results
from fingerflow.reproduce.presses import record_and_analyse
from fingerflow.reproduce.printed_row import Row, Source
from fingerflow.reproduce.slides import record_and_measure
from fingerflow.study.simulated_trials import Design

_ABOUT_SLIDES = (
    "Ten slides at 60 Hz with a pixel of 40 µm: in four the stick region collapses at the printed sizes and "
    "durations, in four it shrinks to nothing, in two the tangential force swings. Frictions, forces, contact sizes "
    "and skin differ from slide to slide. Before a collapse d² falls in a straight line with T/N, as the paper saw no "
    "parabola."
)


def reproduce(folder: Path, papers: Sequence[str] = tuple(TITLES), quick: bool = False, progress: bool = True) -> Path:
    """Reproduce one or both papers in a folder, and return the path of the HTML page with all results in that folder.

    Recordings that exist and trials that are measured are kept.

    Args:
        folder: created if missing; recordings and results are in `slip` and `press`, the page is in `page`.
        papers: names in `TITLES`.
        quick: a small study of presses in place of the whole, in `press-quick`.
        progress: show bars.

    Raises FingerflowError if a file cannot be written.
    """
    page = folder / "page"
    for paper in papers:
        if paper == "slip":
            slides = record_and_measure(folder / paper, progress)
            _compare(page, paper, _ABOUT_SLIDES, slides, slip_rows.ROWS, figures_of_slides.FIGURES, progress)
        else:
            study = record_and_analyse(folder / (f"{paper}-quick" if quick else paper), quick, progress)
            rows = sorted((*method_rows.ROWS, *press_rows.ROWS), key=lambda row: int(row.id[1:]))
            _compare(page, paper, _about(study.design), study, rows, figures_of_presses.FIGURES, progress)
    return write_page(page)


def _about(design: Design) -> str:
    high, low = design.friction
    return (
        f"A study of {design.participants} participants, {design.trials} pair(s) of presses each at every one of "
        f"{len(design.amplitudes)} amplitudes: a skin chain turned about its axis, softer for half of the "
        f"participants, with frictions of {high:g} without and {low:g} at the largest vibration. The observer feels "
        "the difference of divergence, with noise. Equations, settings and models are checked beside it."
    )


def _compare(
    page: Path,
    paper: str,
    about: str,
    source: Source,
    rows: Sequence[Row[Source]],
    figures: Sequence[PrintedFigure[Source] | PrintedMovie[Source]],
    progress: bool,
) -> None:
    """Compute the reproduced results of a paper from its simulated experiment `source`, draw its figures, and write
    both into the folder `page`.
    """
    answers = [row.answer(source) for row in tqdm(rows, desc="rows", disable=not progress)]
    drawn = [one.write(source, page / paper) for one in tqdm(figures, desc="figures", disable=not progress)]
    write_results(page, paper, about, answers, drawn)
