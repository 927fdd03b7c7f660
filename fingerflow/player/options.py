"""Options of the player, on the command line and as arguments of `play`."""

import argparse
import contextlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fingerflow.engines.choice import STREAM_ENGINES
from fingerflow.player.addresses import forms
from fingerflow.player.sources import KINDS
from fingerflow.player.stream_player import Settings

_LEAST = 1e-6  # frames/s (as in scenes) or s; below it the interval to the next frame exceeds the range of the clock
CAMERAS, SENSORS, OUTPUTS = (f"{__package__}.{folder}" for folder in ("sources", "sensors", "outputs"))


def option_parser(prog: str | None = None) -> argparse.ArgumentParser:
    """Return the parser of the player's options."""
    parser = argparse.ArgumentParser(prog, description="Contact area, points and divergence of a live stream.")
    here = Path(__file__).resolve().parents[2]
    add = parser.add_argument
    add("bundle", nargs="?", type=Path, default=here, help="folder of the exported bundle; default: the player's own")
    add("--source", help=f"{KINDS}, or `synthetic`; default: recording.frames of the scene")
    add(
        "--camera",
        metavar="ADDRESS",
        help=f"{forms(CAMERAS)}, or MODULE:FACTORY: factory() gives a callable that returns the next frame, None at "
        "the end",
    )
    add("--scene", type=Path, help="scene file; default: scene.toml of the bundle, the synthetic source needs none")
    add("--shape", type=_count, nargs=2, metavar=("HEIGHT", "WIDTH"), help="of the frames of a raw file")
    add("--dtype", default="uint8", help="of the frames of a raw file, such as '<u2'; default uint8")
    add("--rate", type=_positive, help="play a recording at so many frames a second, as a camera would give them")
    add("--frames", type=_count, help="end after so many frames")
    add("--policy", choices=("every", "latest"), help="every frame (default for files), or the newest (for cameras)")
    add("--queue", type=_count, default=Settings.queue, help="frames that wait at most under the policy `every`")
    add(
        "--engine",
        choices=STREAM_ENGINES,
        help="what computes: the compiled library, or the graphs by ONNX Runtime; default: the first that serves here",
    )
    add(
        "--provider", help="execution provider of ONNX Runtime, such as cpu, cuda or openvino; default: the first there"
    )
    add("--threads", type=_count, default=0, help="of the engine; default one a core less one, of ONNX Runtime one")
    add("--output", type=Path, help="new folder of the results; default stream.output of the scene, or results-TIME")
    add("--json", type=Path, metavar="FILE", help="write the summary to FILE too")
    add("--page", type=_address, default=("127.0.0.1", 8765), metavar="[HOST:]PORT", help="of the live page, or `off`")
    add("--forces", metavar="ADDRESS", help=f"live force sensor: {forms(SENSORS)}")
    repeated: dict[str, Any] = {"action": "append", "default": []}
    add("--send", **repeated, metavar="ADDRESS", help=f"send the values of each frame to {forms(OUTPUTS)}")
    add("--when", **repeated, metavar="CONDITION", help="such as 'gross_contact_area > 20 mm2, margin 2'; needs --then")
    add("--then", **repeated, metavar="ADDRESS", help="where to send when the --when before it becomes true")
    add("--values", type=lambda text: text.split(","), metavar="NAME,...", help="that --send sends; default all")
    add("--benchmark", action="store_true", help="tell which frame rate this PC holds (with --engine, --threads ...)")
    add("--give-up", type=_positive, default=Settings.give_up, metavar="S", help="end after so long without a frame")
    return parser


def _positive(text: str, number: Callable[[str], Any] = float, least: float = _LEAST) -> Any:
    with contextlib.suppress(ValueError):
        if least <= (value := number(text)) < math.inf:
            return value
    raise argparse.ArgumentTypeError(f"{text} is not a number from {least:g} on")


def _count(text: str) -> Any:
    return _positive(text, int, 1)


def _address(text: str) -> tuple[str, int] | None:
    if text == "off":
        return None
    host, _, port = text.rpartition(":")
    if not port.isdigit() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is no [HOST:]PORT and not `off`")
    return host or "127.0.0.1", int(port)
