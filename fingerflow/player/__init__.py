"""Player that runs an exported bundle on a live stream, with numpy and onnxruntime but without torch.

    python -m fingerflow.player --source synthetic  # in the bundle's folder
    fingerflow stream BUNDLE --source frames.npy --scene scene.toml    # the same from the package

A bundle contains this folder unchanged. Frames pass through threads: one for capture, one for each frame that is
computed in parallel, one to measure, one to store. The main thread monitors them, and another serves the live page.
Every array that the graphs read or write is allocated once. Positions are (x, y) px of the views with integer pixel
centres, areas mm², axes mm, times s.

Names are loaded on first use: code that needs only the schema of scenes needs neither numpy nor onnxruntime.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fingerflow.errors import PlayerError as PlayerError
    from fingerflow.player.cli import main as main
    from fingerflow.results.stream_folder import StreamResults as StreamResults
    from fingerflow.results.stream_folder import read_results as read_results
    from fingerflow.results.stream_folder import write_table as write_table

_HOMES = {
    "main": "fingerflow.player.cli",
    "PlayerError": "fingerflow.errors",
    "StreamResults": "fingerflow.results.stream_folder",
    "read_results": "fingerflow.results.stream_folder",
    "write_table": "fingerflow.results.stream_folder",
}
__all__ = ["PlayerError", "StreamResults", "main", "read_results", "write_table"]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}; public are {', '.join(__all__)}")
