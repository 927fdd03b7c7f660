"""Command line of the player."""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import math
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fingerflow.engines.bundle import load_bundle
from fingerflow.engines.choice import STREAM_ENGINES, engine_of_stream
from fingerflow.errors import FingerflowError, PlayerError, first_line
from fingerflow.kernels.library import set_threads, threads
from fingerflow.player.handover import Slot
from fingerflow.player.live_data import LiveForces
from fingerflow.player.played import choose_input
from fingerflow.player.records import RecordLayout
from fingerflow.player.sources import kinds
from fingerflow.player.stream_player import Player, Settings
from fingerflow.player.stream_scene import contradictions, stream_settings
from fingerflow.results.stream_folder import RESULTS_FORMAT, Sink
from fingerflow.schema.bundle_format import COORDINATES
from fingerflow.schema.unfinished import finish, remove, unfinished
from fingerflow.tracker.frame_tracker import StreamTracker

_LEAST = 1e-6  # frames/s (as in scenes) or s; below it the interval to the next frame exceeds the range of the clock
_SUMMARY = {"processed", "latency_ms", "policy"}  # keys that identify a summary
log = logging.getLogger("fingerflow.player")


ReadForces = Callable[[Path], LiveForces | None]


def main(
    arguments: list[str] | None = None, prog: str | None = None, forces_of: ReadForces = lambda scene: None
) -> int:
    """Run the player with command-line arguments and return the exit status.

    The status is 0 at the source's end, 2 after an error of the user, 130 or 143 after Ctrl-C or SIGTERM.

    Args:
        arguments: of the command line.
        prog: name of the command.
        forces_of: reads the forces that a scene file names, for the page; the player alone cannot read them.
    """
    options = _parser(prog).parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname).1s %(message)s", stream=sys.stderr)
    # By default Python lets a thread run for 5 ms before it switches, which is the time budget of a whole frame.
    sys.setswitchinterval(5e-4)
    try:
        return _stream(options, forces_of)
    except FingerflowError as error:
        print(f"fingerflow: {error}", file=sys.stderr)
        return 2


def _stream(options: argparse.Namespace, forces_of: ReadForces) -> int:
    bundle = load_bundle(options.bundle)
    played = choose_input(options, bundle)
    if options.json is not None and not _may_replace(options.json):
        raise PlayerError(f"{options.json}: exists and is no summary of a stream; give --json another name")
    scene, name = played.scene, played.name
    for said in (warnings := contradictions(scene, bundle.recipe)):
        log.warning("%s", said)
    parallel = options.parallel_frames
    # One core is left for the other threads: reading frames, results of the frame before, the page.
    set_threads(options.threads or max(1, threads() - 1))
    of_onnx = parallel > 1 or options.provider is not None
    if options.engine == "native" and of_onnx:
        raise PlayerError(
            "--parallel-frames and --provider are of ONNX Runtime, and the engine native computes one frame at a time "
            "on all threads; leave them out, or take --engine onnx"
        )
    engine = engine_of_stream(bundle, "onnx" if of_onnx else options.engine, options.provider, options.threads or 1)
    # With ONNX Runtime the lag is at least 2, so that sequential and parallel frames give the same numbers.
    lag = 1 if engine.name == "native" else max(2, parallel)
    tracker = StreamTracker(engine, stream_settings(scene, bundle), played.glass, played.dark, lag)
    tracker.warm_up(Slot(bundle))
    layout = RecordLayout(bundle.points)
    named = options.output or scene.output
    folder = named or Path(f"results-{datetime.now():%Y%m%d-%H%M%S}")
    live = options.camera is not None
    every = options.policy == "every" if options.policy else not live
    settings = Settings(
        every=every,
        queue=options.queue if every else 1,
        rate=options.rate or (None if live else scene.frame_rate),
        frames=min((count for count in (options.frames, played.frames) if count is not None), default=None),
        give_up=options.give_up,
        parallel=parallel,
        page=options.page,
    )
    header = {
        "format": RESULTS_FORMAT,
        "started": datetime.now(UTC).isoformat(),
        "fingerflow": bundle.version,
        "recipe": bundle.recipe,
        "graph_sha256": bundle.hashes,
        "engine": engine.described,
        "source": name,
        "policy": "every" if every else "latest",
        "mm_per_px": scene.mm_per_px,
        "topography_to_contact": scene.topography_to_contact.tolist(),
        "threshold": "measured" if tracker.measures else scene.given_threshold,
        "coordinates": COORDINATES,
        "warnings": warnings,
        "record_bytes": layout.dtype.itemsize,
        "fields": layout.fields,
    }
    sink = Sink(folder, header, numbered=named is None)
    try:
        source = played.open_source(played.first)
    except FingerflowError:
        raise
    except Exception as error:
        raise PlayerError(f"{name}: cannot be opened ({type(error).__name__}: {first_line(error)})") from error
    forces = forces_of(played.forces_in) if played.forces_in is not None and options.page else None
    player = Player(tracker, engine.described, bundle, played, source, sink, layout, settings, forces)
    with _stopped_by_signals(player) as received:
        summary = player.run()
    text = json.dumps({**summary, "engine": engine.described, "policy": header["policy"]}, indent=1)
    print(text)
    if options.json is not None:
        part = unfinished(options.json)
        try:
            part.write_text(text + "\n", encoding="utf-8")
            finish(part, options.json)
        except OSError as error:
            remove(part)
            raise PlayerError(
                f"{options.json}: cannot be written ({error.strerror}); results are in {sink.folder}"
            ) from None
    return 128 + received[0] if received else 0


def _may_replace(path: Path) -> bool:
    """Return whether a file may be written: the path is free, or holds the summary of an earlier stream."""
    try:
        return not path.exists() or json.loads(path.read_bytes()).keys() >= _SUMMARY
    except (OSError, ValueError, AttributeError, RecursionError):
        return False


@contextlib.contextmanager
def _stopped_by_signals(player: Player) -> Iterator[list[int]]:
    """Stop the player cleanly at the first Ctrl-C or SIGTERM; a second signal acts as Python does by default.

    Yields the list of received signals.
    """
    received: list[int] = []
    before: dict[int, Any] = {}

    def stop(number: int, _: Any) -> None:
        received.append(number)
        for each, handler in before.items():
            signal.signal(each, handler)
        player.stop()

    if threading.current_thread() is threading.main_thread():
        before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _parser(prog: str | None) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog, description="Contact area, points and divergence of a live stream.")
    here = Path(__file__).resolve().parents[2]
    add = parser.add_argument
    add(
        "bundle",
        nargs="?",
        type=Path,
        default=here,
        help="folder of the exported bundle; default: the player's own",
    )
    add("--source", help=f"{kinds()}, or `synthetic`; default: recording.frames of the scene")
    add(
        "--camera",
        metavar="MODULE:FACTORY",
        help="factory() gives a callable that returns the next frame, None at the end",
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
    add(
        "--threads",
        type=_count,
        default=0,
        help="threads of the engine; default one a core less one, of ONNX Runtime one",
    )
    add(
        "--parallel-frames",
        type=_count,
        default=1,
        metavar="N",
        help="with ONNX Runtime: compute N frames beside each other",
    )
    add("--output", type=Path, help="new folder of the results; default stream.output of the scene, or results-TIME")
    add("--json", type=Path, metavar="FILE", help="write the summary to FILE too")
    add("--page", type=_address, default=("127.0.0.1", 8765), metavar="[HOST:]PORT", help="of the live page, or `off`")
    add("--give-up", type=_positive, default=Settings.give_up, metavar="S", help="end after so long without a frame")
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not _LEAST < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not above {_LEAST:g}")
    return value


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value


def _address(text: str) -> tuple[str, int] | None:
    if text == "off":
        return None
    host, _, port = text.rpartition(":")
    if not port.isdigit() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is no [HOST:]PORT and not `off`")
    return host or "127.0.0.1", int(port)
