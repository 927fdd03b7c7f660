"""Common interface to the trackers of this project and of OpenCV, with forward-backward check and acceptance."""

from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.engines.engine import EngineSettings
from fingerflow.engines.native import NativeEngine
from fingerflow.ops.tracking.track_points import TrackStatus, track_points

# 30 steps or 1e-4 px: ten times as many steps, or a limit of 1e-6 px, change no digit that is reported.
_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 1e-4)


class Found(NamedTuple):
    """Positions (1, N, 2) px, and which of them (N,) the tracker accepts."""

    points: Tensor
    accepted: Tensor


Tracker = Callable[..., Found]


def track_fingerflow(
    previous: Tensor,
    current: Tensor,
    points: Tensor,
    window: int = 21,
    *,
    limit: float = 1.0,
    passes: int = 1,
    **options: Any,
) -> Found:
    """Track by `fingerflow.ops.track_points` and its options, with the limit of the forward-backward error in px.

    One pass by default, as OpenCV's windows are not deformed either.
    """
    with torch.no_grad():
        tracks = track_points(previous, current, points, window, passes=passes, forward_backward_limit=limit, **options)
    return Found(tracks.points, tracks.status[0] == TrackStatus.TRACKED)


def track_opencv(
    previous: Tensor,
    current: Tensor,
    points: Tensor,
    window: int = 21,
    *,
    initial: Tensor | None = None,
    levels: int = 0,
    limit: float = 1.0,
) -> Found:
    """Track by `cv2.calcOpticalFlowPyrLK` there and back; accept points found both ways that return to ``limit`` px."""
    first, second = previous[0, 0].numpy(), current[0, 0].numpy()
    start = points[0].numpy()
    guess = start if initial is None else initial[0].numpy()
    there, found = lucas_kanade(first, second, start, guess, window, levels)
    back, found_back = lucas_kanade(second, first, there, there - (guess - start), window, levels)
    accepted = found & found_back & (np.linalg.norm(back - start, axis=-1) <= limit)
    return Found(torch.from_numpy(there)[None], torch.from_numpy(accepted))


def follow_fingerflow(key: Tensor, points: Tensor, window: int) -> Callable[[Tensor, Tensor, int], list[Found]]:
    """Prepare templates of points (1, N, 2) px in a key frame for the native engine.

    Returns:
        A function of the next frames (K, 1, H, W), their speed (2,) px a frame, and the number of frames per call. It
        finds the points in each frame.
    """
    engine = NativeEngine(EngineSettings(window_px=window))
    start = points[0].numpy()
    templates = engine.prepare(key.numpy(), start)

    def follow(frames: Tensor, speed: Tensor, together: int) -> list[Found]:
        place, moving, found = start, np.broadcast_to(speed.numpy(), start.shape).copy(), list[Found]()
        for some in frames[:, 0].numpy().reshape(-1, together, *frames.shape[2:]):
            followed = engine.track(templates, engine.images(some), place, moving)
            place, moving = followed.place, followed.speed
            own = followed.found
            found += (
                Found(torch.from_numpy(where)[None], torch.from_numpy(status == TrackStatus.TRACKED))
                for where, status in zip(own.points, own.status, strict=True)
            )
        return found

    return follow


def lucas_kanade(
    first: NDArray[np.uint8],
    second: NDArray[np.uint8],
    start: NDArray[np.float32],
    guess: NDArray[np.float32],
    window: int,
    levels: int,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    points, status, _ = cv2.calcOpticalFlowPyrLK(
        first,
        second,
        start[:, None],
        guess[:, None].copy(),
        winSize=(window, window),
        maxLevel=levels,
        criteria=_CRITERIA,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return points[:, 0].astype(np.float32, copy=False), status[:, 0] == 1


#: Peer first.
TRACKERS: dict[str, Tracker] = {"opencv": track_opencv, "fingerflow": track_fingerflow}
