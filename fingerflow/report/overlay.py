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
_ARROW_PX = 40  # px, drawn length of the largest displacement
_CAPTION_PX = 32  # px, height of the line of text above the image


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
        # Paint the last frame first: it sets the contrast, and the finger is in view there.
        painter.paint(int(frames[-1]))
        for frame in frames:
            picture = painter.paint(int(frame), scale)
            words = [f"{times[frame]:+.3f} s"]
            if force is not None and np.isfinite(force[frame]):
                words.append(f"normal force {force[frame]:.2f} N")
            if scale:
                words.append(f"displacement drawn {scale:.3g} times larger")
            yield _captioned(picture, ", ".join(words))


def _captioned(picture: Picture, text: str) -> Picture:
    """Return the picture below a line of text, whose size shrinks where the picture is narrow."""
    font, height, width = cv2.FONT_HERSHEY_DUPLEX, *picture.shape[:2]
    size = min(0.55, 0.55 * (width - 20) / cv2.getTextSize(text, font, 0.55, 1)[0][0])
    drawn = np.zeros((height + _CAPTION_PX, width, 3), np.uint8)
    drawn[_CAPTION_PX:] = picture
    cv2.putText(drawn, text, (10, 21), font, size, (235, 235, 235), 1, cv2.LINE_AA)
    return drawn


def _arrow_scale(result: xr.Dataset) -> float:
    """Return the factor, to one digit, by which displacement arrows are lengthened so that the 0.98 quantile of
    displacement is 40 px long in the video; 0 if no displacement is known.
    """
    length = np.linalg.norm(result["displacement"].values, axis=-1) if "displacement" in result else np.zeros(1)
    known = length[np.isfinite(length)]
    largest = float(np.quantile(known, 0.98)) / float(result.attrs["mm_per_px"]) if known.size else 0.0
    return float(f"{_ARROW_PX / largest:.1g}") if largest > 0 else 0.0
