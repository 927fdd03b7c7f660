"""`python -m bench papers`: simulate recordings, measure them, compare with the printed results, write a page."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from bench.papers import method_rows, press_figures, press_rows, slide_figures, slide_rows
from bench.papers.drawn import PrintedFigure
from bench.papers.page import TITLES, write_page, write_results
from bench.papers.presses import PressStudy, record_and_analyse
from bench.papers.printed import Row
from bench.papers.slides import record_and_measure
from fingerflow.schema.trial_columns import NUMBERS

_ABOUT_SLIDES = (
    "Ten slides at 60 Hz with a pixel of 40 µm: in four the stick region collapses at the printed sizes and "
    "durations, in four it shrinks to nothing, in two the tangential force swings. Frictions, forces, contact sizes "
    "and skin differ from slide to slide. Before a collapse d² falls in a straight line with T/N, as the paper saw no "
    "parabola."
)


def main(arguments: list[str]) -> None:
    """Reproduce the papers that the command line names, and print the path of the page with all results.

    Recordings that exist and trials that are measured are kept, in `slip` and `press` (`press-quick`) of the folder.

    Raises FingerflowError if a file cannot be written.
    """
    parser = argparse.ArgumentParser("python -m bench papers", description=__doc__)
    parser.add_argument("paper", nargs="?", choices=tuple(TITLES), help="slip (2011) or press (2021); default both")
    parser.add_argument(
        "--folder", type=Path, default=Path("bench/out/papers"), help="recordings, results and page; a run goes on"
    )
    parser.add_argument("--quick", action="store_true", help="a small study of presses, in minutes")
    options = parser.parse_args(arguments)
    folder, page = options.folder, options.folder / "page"
    source: Any
    rows: Sequence[Row[Any]]
    figures: Sequence[PrintedFigure[Any]]
    for paper in (options.paper,) if options.paper else TITLES:
        if paper == "slip":
            source = record_and_measure(folder / paper)
            about, rows, figures = _ABOUT_SLIDES, slide_rows.ROWS, slide_figures.FIGURES
        else:
            source = record_and_analyse(folder / (f"{paper}-quick" if options.quick else paper), options.quick)
            about, figures = _about(source), press_figures.FIGURES
            rows = sorted((*method_rows.ROWS, *press_rows.ROWS), key=lambda row: int(row.id[1:]))
        answers = [row.answer(source) for row in tqdm(rows, desc="rows")]
        drawn = [one.write(source, page / paper) for one in tqdm(figures, desc="figures")]
        write_results(page, paper, about, answers, drawn)
    print(f"page: {write_page(page)}")


def _about(study: PressStudy) -> str:
    design, (high, low) = study.design, study.design.friction
    errors = ", ".join(
        f"{number.words} {shown['rms']:.2g} ({shown['bias']:+.2g}) {number.shown_unit.name}"
        for number in map(NUMBERS.__getitem__, ("gross_contact_area", "divergence", "strain", "strain_energy"))
        for shown in (number.shown_values(study.errors.loc[number.name]),)
    )
    return (
        f"An experiment of {design.participants} participants, {design.trials} pairs of presses each at every one of "
        f"{len(design.amplitudes)} amplitudes: a skin chain turned about its axis, softer for those "
        f"who press less, with frictions of {high:g} without and {low:g} at the largest vibration. All "
        f"{len(study.measured):,} presses have the true numbers of their chain, and errors as large as those that this "
        f"engine made on {len(study.pictured)} others, rendered as recordings of {study.design.frame_rate:g} frames/s; "
        "pictures and maps are of these. The observer feels the difference of divergence since onset, with "
        "noise, better in fast presses. The level of friction and the observer's weights were chosen among a few tries "
        "with these rows in view. Strain, energy and divergence are those of the printed analysis, and beside "
        "them those of this engine. Equations, settings and models are checked too. "
        f"Errors of the printed analysis, root mean square (mean): {errors}."
    )
