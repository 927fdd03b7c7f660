"""Page of the reproduction: printed and reproduced results of each paper and its figures, as JSON and as HTML."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from jinja2 import Environment

from bench.papers.drawn import DrawnFigure
from bench.papers.printed import PREDICTED, PUT_IN, SETTING, Answer
from fingerflow import __version__
from fingerflow.results.atomic_write import MARK, write_text

#: Papers in the order of the page, with their titles.
TITLES = {
    "slip": "A. Terekhov & Hayward 2011, Minimal adhesion surface area in tangentially loaded digital contacts",
    "press": "B. Willemet et al. 2021, supplement",
}


def write_results(folder: Path, paper: str, about: str, rows: Sequence[Answer], figures: Sequence[DrawnFigure]) -> None:
    """Write the results of a paper as `slip.json` or `press.json`, from which the page is made.

    `about` describes the simulated experiment.
    """
    content = {
        "paper": paper,
        "title": TITLES[paper],
        "about": about,
        "version": __version__,
        "rows": [asdict(one) for one in rows],
        "figures": [asdict(one) for one in figures],
    }
    text = json.dumps(content, indent=1, ensure_ascii=False)
    write_text(folder / f"{paper}.json", text + "\n")


def read_results(folder: Path) -> list[dict[str, Any]]:
    """Return the results of each paper in a folder as a dictionary, with the number of rows per verdict in `counts`, by
    what the simulation knew of them.
    """
    paths = [folder / f"{paper}.json" for paper in TITLES]
    found = [json.loads(path.read_text(encoding="utf-8")) for path in paths if path.exists()]
    return [{**one, "counts": {basis: counts for basis in (PREDICTED, PUT_IN, SETTING)
                               if (counts := _verdicts(one["rows"], basis))}} for one in found]  # fmt: skip


def _verdicts(rows: list[dict[str, Any]], basis: str) -> dict[str, int]:
    return dict(Counter(row["verdict"] for row in rows if row["basis"] == basis).most_common())


def write_page(folder: Path) -> Path:
    """Write `index.html` from the results of all papers in a folder, and return its path."""
    template = Environment(autoescape=True).from_string(Path(__file__).with_name("page.html").read_text("utf-8"))
    html = template.render(papers=read_results(folder), mark=MARK)
    path = folder / "index.html"
    write_text(path, html)
    return path
