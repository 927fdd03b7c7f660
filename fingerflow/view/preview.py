"""What `process` will find in a frame: its own stages, run for that frame alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from fingerflow.engines.together import run_alone
from fingerflow.errors import FingerflowError
from fingerflow.pipeline.plan import VARIABLES, plan
from fingerflow.pipeline.stages.contact.contact import ContactStage
from fingerflow.pipeline.stages.preparation.frame_check import FrameCheckStage
from fingerflow.pipeline.stages.preparation.inputs import Inputs, open_inputs, read_frames
from fingerflow.pipeline.stages.preparation.loading import LoadingStage
from fingerflow.pipeline.stages.stage import Batch, RunContext
from fingerflow.pipeline.stages.tracking.tracking import TrackingStage
from fingerflow.results.store import MemoryStore
from fingerflow.schema.scene import Scene


@dataclass(frozen=True)
class Preview:
    """Contact of one frame.

    Attributes:
        mask: (h, w) bool, the real contact in the contact view; of a soft sensor the gross one.
        numbers: by the names of the results; NaN where there is no contact.
        markers: (M, 2) px of the view, those of a soft sensor that are found in this frame.
    """

    mask: NDArray[np.bool_]
    numbers: dict[str, Any]
    markers: NDArray[np.floating] | None = None


@dataclass(frozen=True)
class Chosen:
    """The points that would be followed: (N, 2) px of the topography view, in which frame, and warnings."""

    points: NDArray[np.floating]
    frame: int
    warnings: list[str]


class Previewer:
    """The stages of a scene, begun but not finished: they step through single frames.

    Every frame is taken for usable: which are not, `process` tells from all of them together.
    """

    def __init__(self, scene: Scene, before: "Previewer | None" = None) -> None:
        """`before` lends what has been opened, where the files and views are the same.

        Raises FingerflowError for what the user can put right.
        """
        self.scene = scene
        same = before if type(before) is type(self) and _opened(before.scene) == _opened(scene) else None
        self._inputs: Inputs = open_inputs(scene, "cpu") if same is None else same._inputs.with_scene(scene)
        self._trial = self._begin_trial()
        # Forces are resampled once: they do not depend on what is moved on the page.
        lent = same._loading if same is not None and same.scene.forces == scene.forces else None
        self._loading: LoadingStage = lent or self._begin(LoadingStage(self._trial))
        check = FrameCheckStage(self._trial)
        check.usable = np.ones(len(self._trial), dtype=bool)
        self._trial.stages = {LoadingStage: self._loading, FrameCheckStage: check}
        self._seen: dict[int, Preview] = {}
        self._begin_contact(same)

    def _begin_contact(self, before: "Previewer | None") -> None:
        """`before` has the same recording, views and background."""
        self._contact = ContactStage(self._trial)
        self._trial.stages = {**self._trial.stages, ContactStage: self._contact}
        self._begin(self._contact)

    @property
    def times(self) -> NDArray[np.float64]:
        """(frames,) s, of those that count."""
        return self._inputs.times

    @property
    def warnings(self) -> list[str]:
        """Sentences of the opened files and of the stages so far."""
        return [*self._inputs.warnings, *self._loading.warnings, *self._contact.warnings]

    def forces(self) -> dict[str, NDArray[np.float64]]:
        """Forces at the frames that count, by the names of the results."""
        given = {
            "normal_force": self._loading.normal,
            "tangential_force": self._loading.tangential,
            "load_ratio": self._loading.ratio,
        }
        return {name: values for name, values in given.items() if values is not None}

    def contact(self, frame: int) -> Preview:
        """Of a frame, from 0 for the first one that counts."""
        if frame not in self._seen:
            with torch.inference_mode():
                found = run_alone(self._contact.step(self._batch(frame)))
            self._seen = {frame: Preview(found.real_contact_mask[0, 0], numbers_of(self._contact, frame))}
        return self._seen[frame]

    def chosen(self) -> Chosen:
        """The points that `process` would follow, as it chooses them in the first frame (or the last one, backward).

        Raises FingerflowError where there are too few, or no topography view.
        """
        if self.scene.views.topography is None:
            raise FingerflowError("the scene has no topography view: no points are followed, areas are all it gives")
        frame = len(self._trial) - 1 if self.scene.tracking.direction == "backward" else 0
        trial = self._begin_trial(frame + 1)
        trial.stages = {**self._trial.stages}
        tracking = TrackingStage(trial)
        with torch.inference_mode():
            tracking.begin()
            batch = self._batch(frame)
            batch.keep(self._contact, run_alone(self._contact.step(batch)))
            run_alone(tracking.step(batch))
        points = trial.results["position_px"][np.array([frame])][0]
        return Chosen(points, frame, list(tracking.warnings))

    def _begin_trial(self, stored: int = 1) -> RunContext:
        """With room for the results of some frames: the stages write those of the ones that they step through."""
        planned = plan(None, self.scene)
        return RunContext(self._inputs, MemoryStore(VARIABLES, stored), planned.stages, planned.asked, {})

    def _begin(self, stage: Any) -> Any:
        with torch.inference_mode():
            stage.begin()
        return stage

    def _batch(self, frame: int) -> Batch:
        indices = np.array([frame])
        return Batch(indices, read_frames(self._inputs.recording[indices]))


def numbers_of(contact: ContactStage, frame: int) -> dict[str, Any]:
    """What a stage of the contact has written of a frame of its trial."""
    return {name: values[frame] for name, values in contact.series.items() if name != "frame_status"}


def _opened(scene: Scene) -> Sequence[Any]:
    """All that opened files depend on."""
    return (scene.path.parent, scene.recording, dict(scene.views), scene.background, scene.calibration)
