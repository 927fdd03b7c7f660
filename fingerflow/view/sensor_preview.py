"""What `process` will find in a frame of a soft sensor: its markers, and where something touches."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.pipeline.plan import VARIABLES
from fingerflow.pipeline.stages.contact.contact import ContactStage
from fingerflow.pipeline.stages.soft_sensor.marker_contact import CELL_PX, MarkerContactStage
from fingerflow.pipeline.stages.soft_sensor.markers import MarkerStage, Seen
from fingerflow.pipeline.stages.stage import Batch, RunContext
from fingerflow.results.store import MemoryStore
from fingerflow.view.preview import Chosen, Preview, Previewer, numbers_of

_LOOKS = 32  # frames that tell how the gel rests


class SensorPreviewer(Previewer):
    """The stages of a soft sensor, run for the frame that is looked at and 32 that are spread over the recording.

    Markers and their look are those of `process`, which finds them in each frame by itself. How the gel rests, and with
    it the threshold of its light, is told from these few frames, so that the contact is nearly that of `process`.
    """

    _still: MarkerContactStage  # begun with those few frames
    _markers: MarkerStage  # begun with the whole recording: knows the look of its markers

    def _begin_contact(self, before: Previewer | None) -> None:
        self._found: dict[int, Seen] = {}
        if isinstance(before, SensorPreviewer):  # light depends on the threshold alone, markers on nothing that differs
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
        """Of a frame, from 0 for the first one that counts."""
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

    def chosen(self) -> Chosen:
        """Raises FingerflowError: all markers are followed."""
        raise FingerflowError("the markers of a soft sensor are followed, all of them: no points are chosen")

    def _followed(self, frames: NDArray[Any]) -> MarkerContactStage:
        """The stage of the contact of these frames alone, whose markers have been followed through them."""
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
