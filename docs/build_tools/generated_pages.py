"""Pages, figures and tables that the build of the site writes: outputs, keys, measurements, both papers."""

import importlib
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from measured_tables import tables

from bench.papers.page import read_results
from bench.record import RESULTS, newest_suites
from bench.rows import as_text
from fingerflow.pipeline.dictionary import dictionary, unit_note
from fingerflow.schema.key_list import key_list
from fingerflow.schema.scene_kinds import KINDS
from fingerflow.schema.variables import SYMBOLS

HERE = Path(__file__).resolve().parents[1]
SUITES = HERE.parent / "bench" / "suites"
REPRODUCED = HERE / "reproduced"


def _cell(text: object) -> str:
    """Return text escaped for a cell of a Markdown table."""
    plain = str(text)
    for mark in "\\|*_<>$`[]~":
        plain = plain.replace(mark, f"\\{mark}")
    return plain.replace("\n", " ")


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    lines = [head, ["---"] * len(head), *([_cell(cell) for cell in row] for row in rows)]
    return ["| " + " | ".join(line) + " |" for line in lines] + [""]


def outputs_page() -> str:
    """Return the page of variables by stage: unit, dimensions, definition, equation."""
    lines = [
        "# Dictionary of outputs",
        "",
        "Every variable of a result, by the stage that gives it; `fingerflow outputs` prints the same. This page is "
        "written from `fingerflow/schema/variables.py` when the site is built. What is *only where it is named* is "
        "computed when `-v`, or `outputs=` of `fingerflow.process`, asks for it. A result has of these what its kind "
        "of scene and its files allow; a variable that it has not is absent, a value that is not known is NaN.",
        "",
        *_symbols(),
    ]
    stages: dict[str, list[dict[str, Any]]] = {}
    for entry in dictionary():
        stages.setdefault(entry["stage"], []).append(entry)
    for stage, entries in stages.items():
        lines += [f"## {stage.replace('_', ' ').capitalize()}", ""]
        for entry in entries:
            lines += [
                f"({entry['stage']}-{entry['name']})=",
                f"### {_cell(entry['name'])}",
                "",
                _cell(entry["definition"]) + ".",
                "",
                f"```text\n{entry['equation']}\n```",
                "",
                _facts(entry),
                "",
            ]
    return "\n".join(lines)


def _facts(entry: dict[str, Any]) -> str:
    facts = [f"Unit `{entry['units']}`{unit_note(entry)}", f"dimensions `({', '.join(entry['dimensions'])})`"]
    if entry["needs"]:
        facts.append("needs " + ", ".join(f"`{key}`" for key in entry["needs"]))
    if not entry["unasked"]:
        facts.append("only where it is named")
    if entry["flags"]:
        facts.append("values " + ", ".join(f"{value} `{meaning}`" for value, meaning in enumerate(entry["flags"])))
    return "; ".join(facts) + "."


def _symbols() -> list[str]:
    return ["## Symbols", "", _cell(SYMBOLS.strip()), ""]


def keys_page() -> str:
    """Return the page of keys of a scene file: type, range, default, who needs them, meaning."""
    lines = [
        "# Keys of a scene file",
        "",
        "`fingerflow init scene.toml` writes a commented file, and `fingerflow keys` prints this list. Both readers of "
        "scenes, `process` and the player of a stream, refuse what is not listed here, in the same words. This page is "
        "written from `fingerflow/schema/scene_tables.py` when the site is built. `kind` names the kind of scene: "
        + ", ".join(f"`{kind}`" for kind in KINDS)
        + ".",
        "",
    ]
    tables: dict[str, list[tuple[str, ...]]] = {}
    for path, key in key_list().items():
        table, _, name = path.partition(".")
        tables.setdefault(table, []).append((name, *key))
    for name, rows in tables.items():
        lines += [f"## [{name}]", "", *_table(("key", "is", "default", "needed by", "meaning"), rows)]
    return "\n".join(lines)


def measurements_page() -> str:
    """Return the page of the rows of bench/results, with machine and command."""
    lines = [
        "# Measurements in full",
        "",
        "What `python -m bench <suite>` and `python -m tests.silent <group>` have written to `bench/results`, row by "
        "row; this page is made of these files when the site is built. {doc}`/accuracy` says what they mean. Times in "
        "ms, lengths in px where the column does not say.",
        "",
    ]
    for path in sorted(RESULTS.glob("*.json"), reverse=True):
        record = json.loads(path.read_text(encoding="utf-8"))
        machine, versions = record["machine"], record["versions"]
        lines += [
            f"## {path.stem}",
            "",
            f"{_cell(machine['cpu'])}, {machine['cores']} cores, {machine['system']}; torch "
            f"{versions['torch']}, OpenCV {versions['opencv-contrib-python-headless']}; {record['threads']['torch']} "
            f"threads. {_cell(record['remark'])}",
            "",
        ]
        for suite, found in record["suites"].items():
            rows = _pooled(found["rows"])
            columns = list(dict.fromkeys(name for row in rows for name in row))
            about = found["about"].partition("\n\n")[0].replace("\n", " ")
            lines += [f"({path.stem}-{suite})=", f"### {path.stem}: {suite}", "", _cell(about), ""]
            lines += [f"    {found.get('command', f'python -m bench {suite}')}", ""]
            lines += _table(
                [_cell(name) for name in columns], ([as_text(row.get(name)) for name in columns] for row in rows)
            )
    return "\n".join(lines)


def draw_figures(folder: Path) -> None:
    """Draw the figure of each suite that has one, as PNG named after the suite, from its newest rows in bench/results;
    leave a figure that is newer than its rows.
    """
    folder.mkdir(exist_ok=True, parents=True)
    for name, (path, suite) in newest_suites().items():
        figure = folder / f"{name}.png"
        if not (SUITES / f"{name}.py").exists():
            continue  # a group of tests.silent
        module = importlib.import_module(f"bench.suites.{name}")
        drawn = figure.stat().st_mtime if figure.exists() else 0.0
        if hasattr(module, "draw") and drawn < max(path.stat().st_mtime, Path(module.__file__).stat().st_mtime):
            module.draw(suite["rows"], figure)


def _pooled(rows: list[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the rows for all shifts together where a suite has them, otherwise all rows."""
    pooled = [row for row in rows if row.get("shift") == "all"]
    return pooled or rows


def reproduction_page() -> str:
    """Return the page of printed and obtained results of both papers, from docs/reproduced."""
    lines = [
        "# Both papers, printed and obtained",
        "",
        "Recordings of both experiments are simulated, with cameras and forces, and measured by an ordinary study:",
        "",
        "    python -m bench papers",
        "    cp -r bench/out/papers/page/{slip,press}* docs/reproduced",
        "",
        "Only predictions are evidence: right where the 95 % interval of each number lies within a factor of 2 of "
        "print, wrong where one lies outside, otherwise undecided; a missing effect needs a bound. Numbers put into "
        "the simulation are read back where their intervals meet; settings and equations hold or differ. Truth is "
        "that of the simulation. With `--quick` 24 presses of the experiment are rendered as pictures, else 180. The "
        "command also writes the movies.",
        "",
    ]
    for paper in read_results(REPRODUCED):
        lines += [f"## {_cell(paper['title'])}", "", _cell(paper["about"]), ""]
        for basis, verdicts in paper["counts"].items():
            counts = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
            lines += [f"- {basis}: {counts}"]
        lines += [""]
        columns = ("id", "quantity", "where", "printed", "obtained", "truth", "basis", "verdict", "because")
        lines += _table(columns, ([row[name] for name in columns] for row in paper["rows"]))
        for figure in paper["figures"]:
            lines += [
                f"### {paper['title'][0]}, {_cell(figure['name'])}",
                "",
                f"In print: {_cell(figure['printed'])}.",
                "",
            ]
            if figure["file"]:
                alt = f"figure {figure['name']} as obtained"
                lines += [f"```{{image}} ../reproduced/{paper['paper']}/{figure['file']}", f":alt: {alt}", "```", ""]
            lines += [line for said in figure["shown"].splitlines() for line in (_cell(said), "")]
    return "\n".join(lines)


PAGES = {
    "outputs": outputs_page,
    "keys": keys_page,
    "measurements": measurements_page,
    "reproduction": reproduction_page,
}


def write(folder: Path) -> None:
    """Write the pages, figures and tables. An unchanged page is not touched, so that Sphinx does not read it again."""
    draw_figures(folder / "figures")
    (folder / "tables").mkdir(exist_ok=True)
    texts = {name: page() for name, page in PAGES.items()}
    texts |= {f"tables/{name}": "\n".join(_table(rows[0], rows[1:])) for name, rows in tables()}
    for name, text in texts.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("builder-inited", lambda app: write(Path(app.srcdir) / "generated"))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
