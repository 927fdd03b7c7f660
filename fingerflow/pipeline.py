"""The main job: a scene in, a labelled data set out."""

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import numpy as np
import torch
import xarray as xr
from tqdm import tqdm

from fingerflow.plan import plan
from fingerflow.result import Outcome, label
from fingerflow.scene import Scene
from fingerflow.stages import deformation
from fingerflow.stages.contact import ContactStage
from fingerflow.stages.inputs import open_inputs
from fingerflow.stages.loading import load
from fingerflow.stages.tracking import TrackingStage

_BATCH = 8  # frames in memory at a time


def process(
    scene: Scene, outputs: Iterable[str] | None = None, device: str = "auto", progress: bool = False
) -> xr.Dataset:
    """Computes ``outputs`` of a scene, and only what they need.

    Args:
        scene: from :func:`~fingerflow.scene.load_scene`.
        outputs: names of variables, see ``fingerflow.plan.OUTPUTS``; None for all that the scene allows.
        device: "auto" (CUDA where it is there), "cpu", "cuda" ...
        progress: show a bar.

    Returns:
        The data set of :mod:`fingerflow.result`: with what the stages that ran have given.

    Raises:
        FingerflowError: whatever the user can put right, named with its file and value.
    """
    wanted = None if outputs is None else list(outputs)
    stages = plan(wanted, scene.views.topography is not None, scene.forces is not None)
    seconds: dict[str, float] = {}
    with torch.inference_mode():
        inputs = open_inputs(scene, device)
        outcome = Outcome(inputs=inputs, seconds=seconds)
        with _timed(seconds, "loading"):
            outcome.loading = load(inputs)
        with _timed(seconds, "contact"):
            normal = None if outcome.loading is None else outcome.loading.normal
            contact = ContactStage(inputs, normal) if "contact" in stages else None
            tracking = TrackingStage(inputs, contact.largest().gross) if contact and "tracking" in stages else None
        if contact is not None:
            covered = _stream(inputs.scene, contact, tracking, seconds, progress)
            outcome.contact = contact.series
            if tracking is not None:
                outcome.tracks = tracking.series
        if outcome.tracks is not None and outcome.contact is not None:
            with _timed(seconds, "fields"):
                if "displacement" in stages:
                    outcome.displacement = deformation.displace(inputs, outcome.tracks, covered)
                if "fields" in stages and outcome.displacement is not None:
                    outcome.fields = deformation.fields(inputs, outcome.displacement, outcome.contact)
                if "strain" in stages and outcome.displacement is not None:
                    outcome.strain = deformation.strains(inputs, outcome.displacement)
    return label(outcome)


def _stream(
    scene: Scene, contact: ContactStage, tracking: TrackingStage | None, seconds: dict[str, float], progress: bool
) -> np.ndarray:
    """Runs the frames through contact and tracking, batch by batch; (F, N) which points the contact covers."""
    recording = contact.recording
    order = np.arange(len(recording))
    if tracking is not None and scene.tracking.direction == "backward":
        order = order[::-1]
    covered: dict[int, np.ndarray] = {}
    bar = tqdm(total=len(order), desc="frames", unit="frame", disable=not progress)
    with bar:
        for first in range(0, len(order), _BATCH):
            indices = order[first : first + _BATCH]
            with _timed(seconds, "decoding"):
                frames = recording[indices].read()
            with _timed(seconds, "contact"):
                found = contact.run(indices, frames)
            if tracking is not None:
                with _timed(seconds, "tracking"):
                    covered.update(zip(indices.tolist(), tracking.run(indices, frames, found.gross), strict=True))
            bar.update(len(indices))
    return np.stack([covered[i] for i in range(len(order))]) if covered else np.zeros((len(order), 0), dtype=bool)


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    start = time.perf_counter()
    try:
        yield
    finally:
        seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - start
