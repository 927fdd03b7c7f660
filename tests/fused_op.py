"""A stand-in for the tracking kernel of Triton: one op of torch, as a launch of the kernel is one node of a graph."""

import numpy as np
import pytest
import torch
from torch import Tensor

from fingerflow.engines.engine import FoundPoints
from fingerflow.engines.prediction import MotionState
from fingerflow.kernels import tensors as kernels
from fingerflow.kernels.tracking import FollowedPoints
from fingerflow.ops.tracking.templates import Templates, find_templates


@torch.library.custom_op("fingerflow_tests::follow", mutates_args=())
def follow(
    templates: list[Tensor], frames: Tensor, place: Tensor, speed: Tensor, lengths: Tensor, rounds: int, limit: float
) -> list[Tensor]:
    """Track templates through frames as the kernel does, by the portable form; one tensor for each result."""
    batch, count = place.shape[:2]
    course, every = MotionState.begin(*(one.reshape(-1, 2).numpy().copy() for one in (place, speed))), []
    for k in range(len(frames) // batch):
        guess = torch.from_numpy(course.expect().reshape(batch, count, 2))
        image = frames[k * batch : (k + 1) * batch]
        found = find_templates(Templates._make(templates), image, guess, rounds=rounds, forward_backward_limit=limit)
        after = course.see(FoundPoints(*(one.numpy().reshape(1, -1, *one.shape[2:]) for one in found)))
        goes_on = np.repeat(lengths.numpy() > k, count)
        pairs = zip(after, course, strict=True)
        course = MotionState(*(np.where(goes_on.reshape(-1, *[1] * (new.ndim - 1)), new, old) for new, old in pairs))
        every.append(found)
    ends = (torch.from_numpy(one.reshape(batch, count, 2).copy()) for one in course[:2])
    return [*(torch.stack(one) for one in zip(*every, strict=True)), *ends]


def serve_in_place_of_triton(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the stand-in serve where the kernel of Triton would on a GPU, on the processor."""
    fused_tracking = pytest.importorskip("fingerflow.kernels.tensors.fused_tracking", reason="Triton is not installed")
    launched = [False]  # while the stand-in computes, the portable form serves it

    def stand_in(
        templates: Templates,
        frames: Tensor,
        place: Tensor,
        speed: Tensor | None,
        variance: None,
        rounds: int,
        rounding: float,
        limit: float,
        mismatch: float,
        lengths: Tensor | None = None,
    ) -> FollowedPoints[Tensor]:
        pace = torch.zeros_like(place) if speed is None else speed
        every = torch.full((len(place),), len(frames) // len(place)) if lengths is None else lengths
        launched[0] = True
        try:
            return FollowedPoints(*follow(list(templates), frames, place, pace, every, rounds, limit))
        finally:
            launched[0] = False

    monkeypatch.setattr(kernels, "fused_tracking_serves", lambda *tensors: not launched[0])
    monkeypatch.setattr(fused_tracking, "find_templates", stand_in)
