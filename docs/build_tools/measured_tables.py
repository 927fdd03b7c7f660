"""Tables of measured numbers for the pages of the site, made from the newest rows of each suite in bench/results."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from bench.record import newest_suites

Rows = Sequence[Mapping[str, Any]]


def deviations(rows: Rows) -> list[list[str]]:
    """Return errors over stated deviations by quantity, on presses and on slides, recorded and live."""
    found: dict[str, dict[str, str]] = {}
    for row in rows:
        kind, _, quantity = row["case"].partition(": ")
        scenes, _, live = kind.partition(", ")
        ratio, *shares = re.findall(r"[\d.]+", row["number"])
        name = quantity.replace("_", " ") + (", live" if live else "")
        found.setdefault(name, {})[scenes] = f"{ratio}; {', '.join(shares)} %"
    return [["", "presses", "slides"], *([name, *_of(cells, "presses", "slides")] for name, cells in found.items())]


def live(rows: Rows) -> list[list[str]]:
    """Return rates and latencies of the player, by recipe and engine."""
    table = [["recipe, engine", "frames/s as fast as it goes", "processor time over OpenCV's", "at a camera's rate"]]
    for recipe, engine in dict.fromkeys((row["recipe"], row["engine"]) for row in rows):
        some = [row for row in rows if (row["recipe"], row["engine"]) == (recipe, engine)]
        free = next(row for row in some if row["asked_hz"] is None)
        (paced,) = (row for row in some if row["asked_hz"] is not None)
        rate = f"{free['slowest_hz']:.0f} to {free['fastest_hz']:.0f}"
        lost = f"{paced['dropped']} dropped" if paced["dropped"] else "none dropped"
        late = ", ".join(f"{paced[f'{of}_ms']:.3g}" for of in ("median", "p99", "worst"))
        ratio = f"{free['cpu_to_opencv']:.2f}; {paced['cpu_to_opencv']:.2f} at {paced['asked_hz']}/s"
        table.append([f"{recipe}, {engine}", rate, ratio, f"{lost}; {late} ms"])
    return table


def wrong_points(rows: Rows) -> list[list[str]]:
    """Return the share of accepted positions that a fault makes wrong, and the error of the energy, by experiment."""
    found: dict[str, dict[str, str]] = {}
    for row in rows:
        trial, _, fault = row["case"].partition(": ")
        if trial in ("press", "slide"):
            wrong, energy, unknown = re.findall(r"[\d.]+%?|nan", row["number"])
            known = "" if unknown == "0%" else f", NaN in {unknown.removesuffix('%')} % of the frames"
            cells = found.setdefault(fault, {})
            energy = "not stated" if energy == "nan" else energy + known
            cells |= {trial: f"{wrong.removesuffix('%')} %", f"{trial}, energy": energy}
    columns = "press", "press, energy", "slide", "slide, energy"
    return [
        ["fault", "press", "energy", "slide", "energy"],
        *([name, *_of(cells, *columns)] for name, cells in found.items()),
    ]


def bad_frames(rows: Rows) -> list[list[str]]:
    """Return how many bad frames of each kind are excluded, recorded and live, and how far the others are off."""
    found: dict[str, dict[str, list[tuple[int, int, float]]]] = {}
    for row in rows:
        kind, _, case = row["case"].partition(": ")
        if kind in ("recorded", "live"):
            excluded, count, off = re.findall(r"[\d.]+", row["number"])
            fault = re.sub(r"^\d+ ", "", case)
            found.setdefault(fault, {}).setdefault(kind, []).append((int(excluded), int(count), float(off)))
    alike: dict[tuple[str, ...], list[str]] = {}  # faults by their cells
    for fault, kinds in found.items():
        cells = tuple(cell for kind in ("recorded", "live") for cell in _excluded(kinds.get(kind, [])))
        alike.setdefault(cells, []).append(fault)
    head = ["frames", "recorded: excluded", "others", "live: excluded", "others"]
    return [head, *(["; ".join(faults), *cells] for cells, faults in alike.items())]


def _excluded(runs: Sequence[tuple[int, int, float]]) -> tuple[str, str]:
    if not runs:
        return "", ""
    excluded, count = (sum(run[place] for run in runs) for place in (0, 1))
    return "all" if excluded == count else f"{excluded} of {count}", f"{max(run[2] for run in runs):.1f}"


def slip_flag(rows: Rows) -> list[list[str]]:
    """Return the share of the frames in which the slip flag is up, by scene without slip and light."""
    found: dict[str, dict[str, str]] = {}
    for row in rows:
        scene, _, light = row["case"].rpartition(", ")
        if scene:
            found.setdefault(scene, {})[light] = row["number"].removesuffix(" of the frames").replace("%", " %")
    lights = list(dict.fromkeys(light for cells in found.values() for light in cells))
    return [["slip flag up in", *lights], *([scene, *_of(cells, *lights)] for scene, cells in found.items())]


def closed_loop(rows: Rows) -> list[list[str]]:
    """Return what is lost between camera and trigger, and latencies, by way out."""
    names = {
        "results": "frames, to the result",
        "UDP": "triggers, to the receipt by UDP",
        "serial line": "triggers, to the byte from a pseudo-terminal",
    }
    table = [["", "number", "lost", "median, ms", "98 %, ms", "longest, ms"]]
    for row in rows:
        late = [f"{row[name]:.3g}" if name in row else "" for name in ("p50_ms", "p98_ms", "worst_ms")]
        table.append([names[row["way"]], f"{row['expected']:,}", str(row["lost"]), *late])
    return table


def flow(rows: Rows) -> list[list[str]]:
    """Return error and time over Farneback's of each way to dense flow, by scene."""
    found: dict[str, dict[str, str]] = {}
    for row in rows:
        cell = f"{row['epe_px']:.2g} px; {row['time_to_peer']:.3g}"
        found.setdefault(row["way"].replace("fingerflow", "`dense_flow`"), {})[row["scene"]] = cell
    scenes = "whorl", "ridges", "dimetrodon"
    return [["", *scenes], *([way, *_of(cells, *scenes)] for way, cells in found.items())]


def image_ops(rows: Rows) -> list[list[str]]:
    """Return the time of each operation over that of its peer, and the share of the result that is the same."""
    peers = {row["operation"]: row for row in reversed(rows)}  # the first way of each
    head = ["operation", "peer", "its time, ms", "time over the peer's", "same"]
    ours = [row for row in rows if row["way"] == "fingerflow"]
    return [
        head,
        *(
            [
                row["operation"],
                peer["way"],
                f"{peer['ms']:.3g}",
                f"{row['time_to_peer']:.2g}",
                f"{100 * peer['same']:.3g} %",
            ]
            for row, peer in ((row, peers[row["operation"]]) for row in ours)
        ),
    ]


def _of(cells: Mapping[str, str], *names: str) -> list[str]:
    return [cells.get(name, "") for name in names]


#: Each table with the suite whose rows it shows; the file of a table is named after its function.
TABLES: Mapping[Callable[[Rows], list[list[str]]], str] = {
    deviations: "deviations",
    live: "stream",
    wrong_points: "points",
    bad_frames: "frames",
    slip_flag: "slip_flag",
    closed_loop: "closed_loop",
    flow: "flow",
    image_ops: "image_ops",
}


def tables() -> Iterator[tuple[str, list[list[str]]]]:
    """Yield the name and the cells, with the head first, of each table."""
    newest = newest_suites()
    for table, suite in TABLES.items():
        yield table.__name__, table(newest[suite].suite["rows"])
