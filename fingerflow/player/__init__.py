"""Player: computes the results of a live stream with an exported bundle, using numpy and onnxruntime but not torch.

    python -m fingerflow.player --source synthetic  # in the bundle's folder
    fingerflow stream BUNDLE --source frames.npy --scene scene.toml    # the same from the package

A bundle contains this folder unchanged. Frames pass through threads: one for capture, one to
compute, one to measure, one to store, and one for each output and for a force sensor. The main thread
monitors them, and another serves the live page. Frame buffers and records are allocated once. Positions are (x, y) px
of the views with integer pixel centres, areas mm², axes mm, times s.
"""

from fingerflow.errors import PlayerError
from fingerflow.player.cli import main
from fingerflow.player.outputs.output import FrameStamp
from fingerflow.player.playing import live_frames, play
from fingerflow.results.stream_folder import StreamResults, read_results, write_table

__all__ = ["FrameStamp", "PlayerError", "StreamResults", "live_frames", "main", "play", "read_results", "write_table"]
