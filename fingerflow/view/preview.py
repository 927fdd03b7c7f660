"""Preview for one frame of what `process` will compute, by running its stages for that frame only."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.pipeline.plan import VARIABLES, plan
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.preparation.inputs import Inputs, open_inputs, read_frames
from fingerflow.pipeline.stages.preparation.loading import LoadingStage
from fingerflow.pipeline.stages.stage import Batch, RunContext
from fingerflow.pipeline.stages.tracking.tracking_stage import TrackingStage
from fingerflow.results.store import MemoryStore
from fingerflow.schema.scene import Scene
from fingerflow.schema.variables import USABLE


class Previewer:
    """Previewer of a scene: runs stages of `process` for single frames, to show what it will compute.

    Every frame is assumed usable: `process` decides that from all frames together.
    """

    def __init__(self, scene: Scene, before: "Previewer | None" = None) -> None:
        """Open the inputs of a scene, reusing those of the earlier previewer `before` if files and views are unchanged.

        Raises:
            FingerflowError: an input is missing or invalid.
        """
        self.scene = scene
        same = before if before is not None and _input_settings(before.scene) == _input_settings(scene) else None
        self._inputs: Inputs = open_inputs(scene, "cpu") if same is None else same._inputs.replace_scene(scene)
        self.times = self._inputs.times  # s, of the frames that the scene selects from the recording
        self._trial = self._begin_trial(len(self.times))
        # Resample the forces only once, as they do not depend on the views.
        lent = same._loading if same is not None and same.scene.forces == scene.forces else None
        self._loading: LoadingStage = lent or self._begin(LoadingStage(self._trial))
        for name, values in self._loading.series.items():
            self._trial.results.put(name, values)
        self._seen: dict[int, tuple[NDArray[np.bool_], dict[str, Any]]] = {}
        self._contact = ContactStage(self._trial)
        self._trial.stages = {ContactStage: self._contact}
        self._begin(self._contact)

    @property
    def warnings(self) -> list[str]:
        """Return the warnings of opening the input files, of the force stage and of the contact stage."""
        return [*self._inputs.warnings, *self._loading.warnings, *self._contact.warnings]

    def forces(self) -> dict[str, NDArray[np.float64]]:
        """Return normal force, tangential force and their ratio (F,) at the frames that the scene selects, as far as
        known, by variable name.
        """
        names = ("normal_force", "tangential_force", "load_ratio")
        return {name: values for name, values in self._loading.series.items() if name in names}

    def contact(self, frame: int) -> tuple[NDArray[np.bool_], dict[str, Any]]:
        """Return the predicted contact in a frame, given by its index among the selected frames of the recording: the
        mask (h, w) of real contact in the contact view, and values by the names of the results, NaN without contact.
        """
        if frame not in self._seen:
            with torch.inference_mode():
                contact = self._contact.step(self._batch(frame))
            numbers = {name: values[frame] for name, values in self._contact.series.items()}
            self._seen = {frame: (contact.real_contact_mask[0, 0], numbers)}
        return self._seen[frame]

    def chosen(self) -> tuple[NDArray[np.floating], int, list[str]]:
        """Return the points (N, 2) px in the topography view that `process` would detect in its first frame (in the
        last one for backward tracking), the index of that frame, and warnings.

        Raises:
            FingerflowError: too few points, or no topography view.
        """
        if self.scene.views.topography is None:
            raise FingerflowError("the scene has no topography view: no points are followed, areas are all it gives")
        frame = len(self._trial) - 1 if self.scene.tracking.direction == "backward" else 0
        trial = self._begin_trial(frame + 1)
        trial.stages = self._trial.stages
        tracking = TrackingStage(trial)
        with torch.inference_mode():
            tracking.begin()
            batch = self._batch(frame)
            batch.steps[ContactStage] = self._contact.step(batch)
            tracking.step(batch)
        return trial.results["position_px"][np.array([frame])][0], frame, list(tracking.warnings)

    def _begin_trial(self, stored: int) -> RunContext:
        """Return a new context for running stages of `process`, with storage for the results of `stored` frames."""
        planned, store = plan(None, self.scene), MemoryStore(VARIABLES, stored)
        store.put("frame_status", np.full(stored, USABLE))
        return RunContext(self._inputs, store, planned.stages, planned.requested, {})

    def _begin(self, stage: Any) -> Any:
        with torch.inference_mode():
            stage.begin()
        return stage

    def _batch(self, frame: int) -> Batch:
        indices = np.array([frame])
        return Batch(indices, read_frames(self._inputs.recording[indices]))


def all_of_default_stages(scene: Scene) -> list[str]:
    """Return the names of all variables of a default run's stages, including those computed only on request."""
    stages = plan(None, scene).stages
    return [output.name for stage in stages for output in stage.gives if all(map(scene.has, output.needs))]


def _input_settings(scene: Scene) -> Sequence[Any]:
    """Return the scene settings that determine which input files are opened and how."""
    return (scene.path.parent, scene.recording, dict(scene.views), scene.background, scene.calibration)
