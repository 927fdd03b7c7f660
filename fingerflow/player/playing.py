"""Playing a stream from Python: a function is called with each frame, or a loop receives them."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NoReturn

from fingerflow.errors import PlayerError
from fingerflow.player.handover import Channel
from fingerflow.player.opening import open_player
from fingerflow.player.options import option_parser
from fingerflow.player.outputs.callback_output import OnFrame
from fingerflow.player.outputs.output import LiveFrame
from fingerflow.player.stream_player import Player

LiveSource = str | Path | Callable[[], Any] | None


def play(
    bundle: str | Path, source: LiveSource = None, on_frame: OnFrame | None = None, **options: Any
) -> dict[str, Any]:
    """Process a stream of frames with a bundle until it ends, store the results as the command line does, and return a
    summary with frame counts, frame rate and latencies.

    Args:
        bundle: folder of the bundle.
        source: file, folder, "synthetic", or a camera's factory: a function that returns a function which returns the
            next frame. None for that of the options, such as ``camera="opencv:0"``, or of the scene.
        on_frame: called with the stamp and the values of each frame, in a thread of its own. While it is busy the
            newest frame waits and older ones are left out, which the summary counts as overtaken; a file that is played
            without a rate (`rate`, or frame_rate of the scene) waits for it instead.
        options: of the command line, with _ for -, such as ``rate=300``, ``scene="scene.toml"``, ``page="off"`` or
            ``send=["udp:127.0.0.1:5005"]``.

    Raises FingerflowError for all that the user can correct.
    """
    return _open(bundle, source, on_frame, options).run()


def live_frames(bundle: str | Path, source: LiveSource = None, **options: Any) -> Iterator[LiveFrame]:
    """Process a stream and yield for each frame its stamp (number and times) and its live values by name; leaving the
    loop ends the stream.

    Arguments and errors are those of `play`. While the loop is busy the newest frame waits and older ones are left
    out, except those of a file that is played without a rate.
    """
    frames: Channel[LiveFrame] = Channel(1)
    player = _open(bundle, source, lambda frame, values: frames.put((frame, values)), options)
    with ThreadPoolExecutor(1, "play") as thread:
        running = thread.submit(player.run)
        running.add_done_callback(lambda _: frames.close())
        try:
            while (live_frame := frames.get()) is not None:
                yield live_frame
        finally:
            player.stop()
            frames.close()
    running.result()  # raises what has ended the stream


def _open(bundle: str | Path, source: LiveSource, on_frame: OnFrame | None, options: Mapping[str, Any]) -> Player:
    arguments = [str(bundle)]
    for name, value in options.items():
        for item in value if isinstance(value, (list, tuple)) and name != "shape" else [value]:
            arguments += [f"--{name.replace('_', '-')}", *map(str, item if name == "shape" else [item])]
    parser = option_parser("play")
    parser.error = _refuse  # type: ignore[method-assign]
    parsed = parser.parse_args(arguments)
    if source is not None:
        setattr(parsed, "camera" if callable(source) else "source", source if callable(source) else str(source))
    return open_player(parsed, on_frame=on_frame)


def _refuse(message: str) -> NoReturn:
    raise PlayerError(f"play: {message}")
