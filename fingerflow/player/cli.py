"""Command line of the player."""

import argparse
import contextlib
import json
import logging
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fingerflow.errors import FingerflowError, PlayerError
from fingerflow.player.benchmark import benchmark
from fingerflow.player.opening import ReadForces, open_player
from fingerflow.player.options import option_parser
from fingerflow.player.stream_player import Player
from fingerflow.results.atomic_write import write_text

_COMPUTING = ("engine", "provider", "threads")  # options that a benchmark heeds
_SUMMARY = {"processed", "latency_ms", "policy"}  # keys by which a summary of a stream is recognised


def main(arguments: list[str] | None = None, prog: str | None = None, forces_of: ReadForces | None = None) -> int:
    """Run the player with command-line arguments and return the exit status.

    The status is 0 at the source's end, 2 after an error of the user, 130 or 143 after Ctrl-C or SIGTERM.

    Args:
        arguments: of the command line.
        prog: name of the command.
        forces_of: reads the forces that a scene file names; the player alone cannot read them.
    """
    options = option_parser(prog).parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname).1s %(message)s", stream=sys.stderr)
    try:
        if options.benchmark:
            print(benchmark(options.bundle, {name: value for name in _COMPUTING if (value := getattr(options, name))}))
            return 0
        return _stream(options, forces_of)
    except FingerflowError as error:
        print(f"fingerflow: {error}", file=sys.stderr)
        return 2


def _stream(options: argparse.Namespace, forces_of: ReadForces | None) -> int:
    if options.json is not None and not _may_replace(options.json):
        raise PlayerError(f"{options.json}: exists and is no summary of a stream; give --json another name")
    player = open_player(options, forces_of)
    with _stopped_by_signals(player) as received:
        summary = player.run()
    text = json.dumps(summary, indent=1)
    print(text)
    if options.json is not None:
        write_text(options.json, text + "\n")
    return 128 + received[0] if received else 0


def _may_replace(path: Path) -> bool:
    """Return whether a file may be written: the path is free, or holds the summary of an earlier stream."""
    try:
        return not path.exists() or (path.is_file() and json.loads(path.read_bytes()).keys() >= _SUMMARY)
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
