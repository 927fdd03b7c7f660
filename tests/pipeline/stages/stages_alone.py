"""Helpers that run stages without a recording, on results of earlier stages passed as arrays."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray

from fingerflow.engines.choice import engine_for
from fingerflow.engines.engine import EngineSettings
from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.pipeline.plan import VARIABLES
from fingerflow.pipeline.run import _pass
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.preparation.inputs import Inputs
from fingerflow.pipeline.stages.stage import RunContext, Stage
from fingerflow.pipeline.stages.tracking.tracking_stage import TrackingStage
from fingerflow.results.store import MemoryStore


def inputs_of(frames: int, mm_per_px: float, strain: str, template: str = "keyframe") -> Inputs:
    """Return inputs that have settings and an image scale, but no recording."""
    scene = SimpleNamespace(
        kind="press",
        has=lambda key: True,
        fields=SimpleNamespace(
            reference="onset",
            gauge_length_mm=1.6,
            strain=strain,
            young_modulus_mpa=1.0,
            poisson_ratio=0.4,
            depth_mm=2.0,
            rate_window_s=0.05,
        ),
        forces=None,
        views=SimpleNamespace(contact=None, topography=None),
        recording=SimpleNamespace(first_frame=0),
        tracking=SimpleNamespace(template=template, direction="forward", window_px=25),
        calibration=SimpleNamespace(mm_per_px=mm_per_px, topography_to_contact=np.eye(2, 3), intrinsics=None),
    )
    cpu = torch.device("cpu")
    engine = engine_for("auto", EngineSettings(gauge_length_mm=1.6, strain=strain), cpu)
    return Inputs(cast(Any, scene), cast(Any, None), np.arange(frames) / 300, cpu, [], engine)


def trial_of(inputs: Inputs, contact: dict[str, Any], frames: int, **given: NDArray[Any]) -> RunContext:
    """Return a run context whose variables have the values `given` and those of the series `contact`."""
    inputs.times = inputs.times[:frames]
    trial = RunContext(inputs, MemoryStore(VARIABLES, frames), (), frozenset(given), {})
    stage = object.__new__(ContactStage)
    stage.inputs, stage.cell_px, stage.faint_rim_mm = inputs, 4, 0.0
    tracking = object.__new__(TrackingStage)
    tracking._settings = inputs.scene.tracking if hasattr(inputs.scene, "tracking") else None  # type: ignore[assignment]
    trial.stages = {ContactStage: stage, TrackingStage: tracking}
    for name, values in ({"frame_status": np.zeros(frames)} | contact).items():
        trial.results.put(name, values[:frames])
    if "position" in given and "status" not in given:  # known points are tracked and were seeded in the first frame
        lost = np.isnan(given["position"]).any(-1)
        given["status"] = np.where(lost, int(TrackStatus.NOT_CONVERGED), int(TrackStatus.TRACKED)).astype(np.uint8)
    if (deviation := given.get("position_std_px")) is not None:
        given = {"position_noise_px": deviation, "position_anisotropy": np.zeros((deviation.shape[1], 2))} | given
    for name, values in given.items():
        sizes = dict(zip(VARIABLES[name].dims, values.shape, strict=True))
        trial.results.put(name, values, **{dim: size for dim, size in sizes.items() if dim not in ("frame", "xy")})
    return trial


def run(trial: RunContext, *stages: Stage) -> None:
    """Run all parts of these stages in one pass."""
    trial.stages = {**trial.stages, **{type(stage): stage for stage in stages}}
    _pass(stages, trial, {}, progress=False)


def values_of(trial: RunContext, name: str) -> NDArray[Any]:
    """Return all values of a variable."""
    return trial.results[name][:]
