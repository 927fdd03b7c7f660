"""Tracking of markers of real soft sensors with default settings, compared with spots found by OpenCV in each frame.

The clips are those of a folder `shared/data/tactile` beside the checkout, which is no part of this project.

- points: markers that have a number; spots: dark round ones that the border does not touch, in all frames;
- followed: percent of the spots with a point within 1.5 px; least: the same of the worst frame;
- flagged: percent of the points and frames whose status gives a reason, `cut` of them because of the border;
- off: points that are accepted and have no spot within 3 px although they lie 12 px and more inside, in all frames;
- slip: frames that are flagged as gross slip; cpu_ms: a frame, one thread, decoding and all default outputs included.
"""

import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.environment import one_thread
from bench.rows import Row, Skipped
from fingerflow import process
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.recordings import open_recording
from fingerflow.schema.scene_template import gel_scene_text

CLIPS = Path(__file__).resolve().parents[3] / "shared" / "data" / "tactile"
_NEAR_PX, _OFF_PX, _INSIDE_PX = 1.5, 3.0, 12.0


def run(quick: bool) -> list[Row]:
    """Return a row per clip; the shortest alone with --quick."""
    clips = sorted(CLIPS.glob("*.avi"), key=lambda clip: clip.stat().st_size)
    if not clips:
        raise Skipped(f"{CLIPS} holds no clip")
    return [_measured(clip) for clip in (clips[:1] if quick else clips)]


def _measured(clip: Path) -> Row:
    with tempfile.TemporaryDirectory() as folder, open_recording(clip) as recording, one_thread():
        scene = Path(folder) / "scene.toml"
        scene.write_text(gel_scene_text(clip.as_posix(), recording.frame_shape, 0.06), encoding="utf-8")
        begun = time.process_time()
        result = process(scene)
        seconds = time.process_time() - begun
        pictures = recording.read()
    near, count, off, height, width = [], [], 0, *pictures.shape[1:]
    for picture, points in zip(pictures, result["position_px"].values, strict=True):
        spots = dark_spots(picture)
        known = points[np.isfinite(points).all(-1)]
        apart = np.linalg.norm(spots[:, None] - known[None], axis=-1)
        near.append(int((apart.min(1) < _NEAR_PX).sum()))
        count.append(len(spots))
        inside = np.minimum(known, np.array([width - 1, height - 1]) - known).min(1) > _INSIDE_PX
        off += int((apart.min(0)[inside] > _OFF_PX).sum())
    status = result["status"].values
    return {
        "clip": clip.stem,
        "frames": len(pictures),
        "points": result.sizes["point"],
        "spots": sum(count),
        "followed": 100 * sum(near) / sum(count),
        "least": 100 * min(one / all_ for one, all_ in zip(near, count, strict=True)),
        "flagged": 100 * float((status != TrackStatus.TRACKED).mean()),
        "cut": 100 * float((status == TrackStatus.LEFT_FRAME).mean()),
        "off": off,
        "slip": " ".join(str(k) for k in np.flatnonzero(result["gross_slip"].values)),
        "cpu_ms": 1000 * seconds / len(pictures),
    }


def dark_spots(frame: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return centroids (M, 2) px of round dark spots off the border, by a local threshold and connected components."""
    smooth = cv2.GaussianBlur(frame, (0, 0), 1.0)
    dark = cv2.adaptiveThreshold(smooth, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, 51, 18)
    _, _, stats, centres = cv2.connectedComponentsWithStats(dark)
    left, top, width, height, area = stats[1:].T
    whole = (left > 0) & (top > 0) & (left + width < frame.shape[1]) & (top + height < frame.shape[0])
    is_round = (area > 50) & (np.maximum(width, height) < 1.8 * np.minimum(width, height))
    return np.asarray(centres[1:][whole & is_round])
