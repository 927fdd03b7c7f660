"""Closed loop on this machine: a recording as camera, a trigger at a contact area, received by UDP and a serial line.

The recording is a synthetic press, two views of 512 x 640 px, played forwards and backwards by a camera module that
waits for the time of each frame, adds noise of one grey level and gives its own time stamp. The player of the bundle of
`export/exact.toml` runs as on a lab PC. A trigger is due wherever the recorded gross area rises through 20 mm²:
`expected` counts them in the records. Latencies run from the camera's stamp to the receipt, in this process, of the
datagram or of the byte at the other end of a pseudo-terminal; in the row `results` to the result, of all frames.
`p50_ms` is the median, `p99_ms` the latency that 1 % exceed. Two processes share the cores; `load` is how many
processes the machine had to run.
"""

import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import tty
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import FuncFormatter

from bench.bare_environment import variables
from bench.drawing import BLUE, GREEN, RED, Mark, saved_axes, scale_by_powers
from bench.rows import Row, Skipped, number
from bench.streams import exported
from fingerflow.player import read_results
from fingerflow.player.camera_clock import unix_now
from fingerflow.synthetic import Press, write_recording

RATE, FRAMES, LIMIT = 300, 120, 20.0  # frames/s, frames of the press, mm²
RECIPE = Path(__file__).parents[2] / "export" / "exact.toml"
# Shares of latencies, in %, that do not exceed the quantiles of a row.
SHARES = (0, 10, 20, 30, 40, 50, 60, 70, 80, 90, 95, 98, 99, 99.5, 99.8, 99.9)
_CAMERA = '''
import time

import numpy as np


def make():
    """Play frames.npy forwards and backwards at {rate} frames a second, as a camera with a clock of its own."""
    frames = np.load("{frames}", mmap_mode="r")
    noise = np.round(np.random.default_rng(0).normal(0, 1, frames[0].size + 4099)).astype(np.int8).view(np.uint8)
    period, number, start = 2 * len(frames) - 2, 0, time.perf_counter() + 0.5

    def next_frame():
        nonlocal number
        place = number % period
        begin = number * 1009 % 4099
        frame = np.clip(frames[min(place, period - place)], 5, 250)
        frame += noise[begin : begin + frame.size].reshape(frame.shape)
        stamp = number / {rate}
        number += 1
        time.sleep(max(0.0, start + stamp - time.perf_counter()))
        return frame, stamp

    return next_frame
'''


def run(quick: bool) -> list[Row]:
    """Return a row per way out, and one of the results."""
    if sys.platform == "win32":
        raise Skipped("it needs a pseudo-terminal")
    frames = RATE * (5 if quick else 60)
    with tempfile.TemporaryDirectory() as folder, exported(RECIPE.read_text(encoding="utf-8")) as bundle:
        return measure(Path(folder), bundle, frames)


def measure(folder: Path, bundle: Path, frames: int) -> list[Row]:
    """Return the rows of a stream of so many frames, with the recording and the results in a folder."""
    trial = folder / "press"
    write_recording(trial, Press(n_frames=FRAMES, frame_rate=RATE, rise_time=0.3), progress=False)
    (bundle / "recorded_camera.py").write_text(_CAMERA.format(rate=RATE, frames=trial / "frames.npy"))
    terminal, line = os.openpty()
    tty.setraw(terminal)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(1)
        datagrams = _Receipts(lambda: receiver.recv(4096))
        one_byte = _Receipts(lambda: os.read(terminal, 1))
        condition = f"gross_contact_area > {LIMIT} mm2"
        command = [sys.executable, "-m", "fingerflow.player", "--scene", str(trial / "scene.toml"), "--page", "off"]
        command += ["--camera", "recorded_camera:make", "--policy", "every", "--frames", str(frames)]
        command += ["--output", str(folder / "results"), "--when", condition, "--then"]
        command += [f"udp:127.0.0.1:{receiver.getsockname()[1]}", "--when", condition]
        command += ["--then", f"serial:{os.ttyname(line)}:1"]
        subprocess.run(command, cwd=bundle, env=variables(), check=True, stdout=subprocess.DEVNULL)
        os.write(line, b"\n")  # the last byte ends the reader
        found = datagrams.end(), one_byte.end()
    os.close(terminal)
    os.close(line)
    records, summary = (
        read_results(folder / "results").records,
        json.loads((folder / "results/summary.json").read_text()),
    )
    area = records["gross_contact_area"]
    area = area[np.isfinite(area)]
    expected = int((np.diff(area > LIMIT, prepend=False) & (area > LIMIT)).sum())
    messages = [json.loads(data) for _, data in found[0]]
    taken = [message["camera_time"] for message in messages]
    bytes_ = [when for when, data in found[1] if data == b"1"]
    processed = records["latency"][np.isfinite(records["latency"])]
    rows: list[Row] = [
        {"way": "results", "expected": frames, "received": summary["processed"], "lost": frames - summary["processed"]}
        | _quantiles(1e3 * processed)
    ]
    for way, received in (("UDP", [when for when, _ in found[0]]), ("serial line", bytes_)):
        late = 1e3 * (np.array(received) - np.array(taken[: len(received)]))
        counts = {"expected": expected, "received": len(received), "lost": expected - len(received)}
        rows.append({"way": way} | counts | _quantiles(late) | {"load": os.getloadavg()[0]})
    return rows


def _quantiles(late: np.ndarray[Any, Any]) -> dict[str, float]:
    """Return the quantiles of latencies in ms, as many as their number resolves, and the largest."""
    shares = [share for share in SHARES if share <= 100 * (1 - 1 / len(late))]
    found = {f"p{share}_ms": float(np.percentile(late, share)) for share in shares}
    return found | {"worst_ms": float(late.max())}


_WAYS = {
    "results": ("frames, to the result", Mark(BLUE)),
    "UDP": ("triggers, to the receipt by UDP", Mark(RED)),
    "serial line": ("triggers, to the byte from a pseudo-terminal", Mark(GREEN, "s", filled=False)),
}


def draw(rows: Sequence[Row], path: Path) -> None:
    """Draw the share of frames and triggers that take longer than a latency."""
    with saved_axes(path, 3.2, width=7.0) as (axes,):
        for row in rows:
            name, mark = _WAYS[str(row["way"])]
            count, shares = number(row, "received"), [share for share in SHARES if f"p{share}_ms" in row]
            late = [*(number(row, f"p{share}_ms") for share in shares), number(row, "worst_ms")]
            longer = [*(100 - share for share in shares), 100 / count]
            axes.plot(late, longer, label=f"{count:,.0f} {name}", **mark.style)
        for axis in (axes.xaxis, axes.yaxis):
            scale_by_powers(axis)
        axes.yaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g} %"))
        axes.axvline(1e3 / RATE, color="0.7", linewidth=0.8, zorder=0)
        axes.annotate(
            "next frame",
            (1e3 / RATE, 1),
            (3, 0),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            va="top",
            fontsize=8,
            color="0.4",
        )
        axes.set(xlabel="latency from the camera's time stamp (ms)", ylabel="share that takes longer")
        axes.legend(frameon=False, fontsize=8)


class _Receipts:
    """Thread that receives until nothing comes for a second after `end`, with the time of each receipt."""

    def __init__(self, receive: Callable[[], bytes]) -> None:
        self._receive, self._found = receive, list[tuple[float, bytes]]()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while True:
            try:
                data = self._receive()
            except TimeoutError:
                if self._ended.is_set():
                    return
                continue
            self._found.append((unix_now(), data))
            if data == b"\n":
                return

    def end(self) -> list[tuple[float, bytes]]:
        """Return all receipts in order."""
        self._ended.set()
        self._thread.join()
        return self._found
