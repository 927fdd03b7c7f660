"""Mean images of the empty glass, and without light."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fingerflow.engines.bundle import Bundle
from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError
from fingerflow.player.scene import ViewRange
from fingerflow.player.sources import open_source

_STILLS = 64  # frames of the empty glass that are averaged: the noise is then an eighth of a frame's


def mean_view(path: Path, view: ViewRange, bundle: Bundle, shape: tuple[int, int] | None, dtype: str) -> Array:
    """Return a view (H, W) float32 of the mean of the first 64 frames of a file; frames may hold the view alone.

    Raises PlayerError where the file has no frame, or frames of another size or bit depth than the camera's.
    """
    source = open_source(path, shape, dtype)
    total, count = np.zeros(view.shape), 0
    try:
        while count < _STILLS and (frame := source.read()) is not None:
            if frame.dtype.kind != "f" and frame.dtype != bundle.dtype:
                raise PlayerError(
                    f"{path}: a frame is {frame.dtype}, the bundle takes {bundle.dtype} (bit_depth "
                    f"{bundle.bit_depth}): grey levels of two depths cannot be compared; record it with the settings "
                    "of the stream"
                )
            part = frame if frame.shape == view.shape else view.crop(frame)
            if part.shape != view.shape:
                raise PlayerError(
                    f"{path}: a frame is {frame.shape}, the view of the scene needs (H, W) of at least "
                    f"{(view.rows[1], view.columns[1])}; record it with the settings of the stream"
                )
            total, count = total + part, count + 1
    finally:
        source.close()
    if not count:
        raise PlayerError(f"{path}: has no frame; one of the empty glass is needed")
    mean: Array = (total / count).astype(np.float32)
    return mean
