"""Page of the reproduction: printed and reproduced results of each paper and its figures, as JSON and as HTML."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment

from fingerflow import __version__
from fingerflow.reproduce.drawn_figure import DrawnFigure
from fingerflow.reproduce.printed_row import Answer
from fingerflow.results.atomic_write import MARK, write_atomically

#: Papers in the order of the page, with their titles.
TITLES = {
    "slip": "A. Terekhov & Hayward 2011, Minimal adhesion surface area in tangentially loaded digital contacts",
    "press": "B. Willemet et al. 2021, supplement",
}


@dataclass(frozen=True)
class PaperResults:
    """Results of the reproduction of one paper: description of the simulated experiment, table rows, and figures."""

    paper: str
    about: str
    rows: Sequence[Answer]
    figures: Sequence[DrawnFigure]


def write_results(found: PaperResults, folder: Path) -> None:
    """Write the results of a paper as `slip.json` or `press.json`, from which the page is made."""
    content = {
        "paper": found.paper,
        "title": TITLES[found.paper],
        "about": found.about,
        "version": __version__,
        "rows": [one.as_json() for one in found.rows],
        "figures": [asdict(one) for one in found.figures],
    }
    text = json.dumps(content, indent=1, ensure_ascii=False)
    write_atomically(folder / f"{found.paper}.json", lambda part: part.write_text(text + "\n", encoding="utf-8"))


def read_results(folder: Path) -> list[dict[str, Any]]:
    """Return the results of each paper in a folder as a dictionary, with the number of rows per verdict in `counts`."""
    paths = [folder / f"{paper}.json" for paper in TITLES]
    found = [json.loads(path.read_text(encoding="utf-8")) for path in paths if path.exists()]
    return [{**one, "counts": _counts(one["rows"])} for one in found]


def write_page(folder: Path) -> Path:
    """Write `index.html` from the results of all papers in a folder, and return its path."""
    template = Environment(autoescape=True).from_string(files(__package__).joinpath("page.html").read_text("utf-8"))
    html = template.render(papers=read_results(folder), mark=MARK)
    path = folder / "index.html"
    write_atomically(path, lambda part: part.write_text(html, encoding="utf-8"))
    return path


def _counts(rows: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    return dict(Counter(row["verdict"] for row in rows).most_common())
