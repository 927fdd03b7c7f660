"""Preview for one frame of a soft sensor of what `process` will compute: markers and contact."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.pipeline.plan import VARIABLES
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.soft_sensor.marker_contact import CELL_PX, MarkerContactStage
from fingerflow.pipeline.stages.soft_sensor.sensor_markers import MarkerStage, Seen
from fingerflow.pipeline.stages.stage import Batch, RunContext
from fingerflow.results.store import MemoryStore
from fingerflow.view.preview import PredictedPoints, Preview, Previewer, numbers_of

_LOOKS = 32  # number of frames from which the gel's rest state is estimated


class SensorPreviewer(Previewer):
    """Previewer of a soft sensor: runs its stages for the previewed frame and for 32 frames spread over the recording.

    Markers and their appearance are those of `process`, which finds them in each frame independently. The gel's rest
    state, and with it the threshold of its light, is estimated from these few frames, so that the contact is nearly
    that of `process`.
    """

    _still: MarkerContactStage  # stage begun with these few frames
    _markers: MarkerStage  # stage begun with the whole recording, which holds the appearance of its markers

    def _begin_contact(self, before: Previewer | None) -> None:
        self._found: dict[int, Seen] = {}
        if isinstance(before, SensorPreviewer):  # reuse the markers, which do not depend on the settings that differ
            self._markers, self._found = before._markers, before._found
        else:
            self._markers = MarkerStage(self._trial)
            self._begin(self._markers)
        count = len(self._trial)
        self._looks = np.unique(np.linspace(0, count - 1, min(count, _LOOKS)).round().astype(int))
        with torch.inference_mode():
            self._still = self._followed(self._looks)
            self._still.begin()
        self._contact = self._still

    def contact(self, frame: int) -> Preview:
        """Return the predicted contact in a frame, given by its index among the selected frames of the recording."""
        if frame not in self._seen:
            frames = np.union1d(self._looks, [frame])
            place = int(np.searchsorted(frames, frame))
            with torch.inference_mode():
                contact = self._followed(frames)
                contact.begin_as(self._still)
                pictures = contact.inputs.recording[[place]].read()
                cells: NDArray[np.bool_] = contact.step(Batch(np.array([place]), pictures))[0]
            height, width = self.scene.views["camera"].shape
            mask = np.zeros((height, width), dtype=bool)
            whole = np.kron(cells, np.ones((CELL_PX, CELL_PX), dtype=bool))
            mask[: whole.shape[0], : whole.shape[1]] = whole
            markers = self._found[frame].points.numpy()
            self._seen = {frame: Preview(mask, numbers_of(contact, place), markers)}
        return self._seen[frame]

    def chosen(self) -> PredictedPoints:
        """Raise FingerflowError: a soft sensor has printed markers, so no points are detected on skin."""
        raise FingerflowError("the markers of a soft sensor are followed, all of them: no points are seeded")

    def _followed(self, frames: NDArray[Any]) -> MarkerContactStage:
        """Return the contact stage of a soft sensor for the frames at these indices, after detecting the sensor's
        markers in them and matching them from frame to frame.
        """
        inputs = self._inputs
        some = replace(inputs, recording=inputs.recording[frames], times=inputs.times[frames])
        trial = RunContext(some, MemoryStore(VARIABLES, len(frames)), self._trial.planned, self._trial.asked, {})
        markers = MarkerStage(trial)
        markers.look = self._markers.look
        view = self.scene.views["camera"]
        for frame in map(int, frames):
            if frame not in self._found:
                self._found[frame] = markers.see(inputs.view(inputs.recording[[frame]].read(), view))
            markers.take(self._found[frame])
        markers.finish()
        contact = MarkerContactStage(trial)
        trial.stages = {MarkerStage: markers, ContactStage: contact}
        return contact
