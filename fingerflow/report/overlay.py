"""Video of a result: the views of the recording with contact, points and displacement drawn over them."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import xarray as xr

from fingerflow.recordings import open_recording
from fingerflow.report.video_writer import encode_video
from fingerflow.report.view_painter import Picture, ViewPainter
from fingerflow.results.atomic_write import write_atomically
from fingerflow.schema.scene import Scene

_MOST_FRAMES = 300
_ARROW_PX = 40  # drawn length of the largest displacements


def write_overlay(result: xr.Dataset, scene: Scene, path: Path) -> Path:
    """Write an overlay video (MP4) of at most 300 evenly spaced frames, with the scale of the arrows as text."""
    write_atomically(path, lambda part: encode_video(_pictures(result, scene), part))
    return path


def _pictures(result: xr.Dataset, scene: Scene) -> Iterator[Picture]:
    count = result.sizes["frame"]
    frames = np.unique(np.linspace(0, count - 1, min(count, _MOST_FRAMES)).round().astype(int))
    scale = _arrow_scale(result)
    times = result["time"].values
    force = result["normal_force"].values if "normal_force" in result else None
    with open_recording(scene.recording.frames, frame_rate=scene.recording.frame_rate) as recording:
        painter = ViewPainter(result, scene, recording)
        # Sets the contrast on the last frame, where the finger is in view.
        painter.paint(int(frames[-1]))
        for frame in frames:
            picture = painter.paint(int(frame), scale)
            text = f"{times[frame]:+.3f} s"
            if force is not None and np.isfinite(force[frame]):
                text += f"   {force[frame]:.2f} N"
            if "gross_slip" in result and result["gross_slip"].values[frame]:
                text += "   GROSS SLIP"
            if scale:
                text += f"   arrows {scale:.3g} x"
            for colour, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):  # readable on bright pictures too
                cv2.putText(picture, text, (10, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, width, cv2.LINE_AA)
            yield picture


def _arrow_scale(result: xr.Dataset) -> float:
    """Return the arrow scale, to one digit, that draws the 0.98 quantile of displacement as 40 px; 0 if unknown."""
    if "displacement" not in result:
        return 0.0
    length = np.linalg.norm(result["displacement"].values, axis=-1)
    if not np.isfinite(length).any():
        return 0.0
    largest = float(np.nanquantile(length, 0.98)) / float(result.attrs["mm_per_px"])
    return float(f"{_ARROW_PX / largest:.1g}") if largest > 0 else 0.0
