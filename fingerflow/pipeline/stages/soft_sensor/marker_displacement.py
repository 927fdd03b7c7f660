"""Displacement of each marker of a soft sensor, relative to the frame in which the gel is at rest."""

import numpy as np

from fingerflow.errors import FingerflowError
from fingerflow.pipeline.stages.displacement.displacement_stage import DisplacementStage, Moved
from fingerflow.pipeline.stages.preparation.reference import Reference
from fingerflow.pipeline.stages.preparation.series import nanmedian
from fingerflow.pipeline.stages.soft_sensor.sensor_markers import MarkerStage
from fingerflow.pipeline.stages.stage import Batch
from fingerflow.pipeline.stages.tracking.tracking_stage import TrackingStage

_REST = {"reference_position": "position at rest", "displacement": "displacement since rest"}


class MarkerDisplacementStage(DisplacementStage):
    """Stage that measures the displacement of all markers, in contact or not, relative to the gel at rest.

    The gel is elastic and has a shape of its own. A marker that is not wholly in view at rest has a position but no
    displacement.
    """

    name = "marker_displacement"
    instead = True
    after = (TrackingStage, MarkerStage)

    def begin(self) -> None:
        scene, markers = self.inputs.scene, self.trial.stage(MarkerStage)
        if scene.fields.reference != "onset":
            raise FingerflowError(
                f"{scene.path}: fields.reference is {scene.fields.reference!r}; displacement of a soft sensor counts "
                "from where its gel rests, whatever touches it: leave the key out"
            )
        self.since = Reference(None, "the frames in which the gel rests")
        self._attributes = self.since.attributes(0)
        points, first_frame = len(markers.rest), scene.recording.first_frame
        touched = self.results["in_contact"][:] > 0
        self.reference_px, self.reference = markers.rest, self.inputs.on_glass(markers.rest)
        self.onset = self.begins = np.where(touched.any(0), touched.argmax(0), -1).astype(np.int32)
        self.of_onset = np.zeros((points, 2, 2))
        self._at_rest = (self.results["position_std_px"][markers.rest_frame : markers.rest_frame + 1][0]) ** 2
        variance = self.results["position_std_px"][:] ** 2
        known = np.isfinite(variance)
        self.noise = np.where(known, variance, 0).sum(0) / np.maximum(known.sum(0), 1) * self.mm_per_px**2
        self.results.put("onset_frame", np.where(self.onset < 0, -1, self.onset + first_frame), point=points)
        self.entered, self.by_onsets = np.zeros(0, dtype=np.intp), False
        self.results.put("entry", (self.onset >= 0).astype(np.uint8))
        self.results.put(
            "reference_position", self.reference, {"long_name": _REST["reference_position"]} | self._attributes
        )
        self.results.create("displacement", {"long_name": _REST["displacement"]} | self._attributes)
        self.results.create("displacement_std")

    def step(self, batch: Batch) -> Moved:
        displacement = self.results["position"][batch.indices] - self.reference
        variance = self.results["position_std_px"][batch.indices] ** 2 + self._at_rest
        variance = np.where(np.isfinite(displacement).all(-1), variance * self.mm_per_px**2, np.nan).astype(np.float32)
        self.results["displacement"][batch.indices] = displacement
        self.results["displacement_std"][batch.indices] = np.sqrt(variance)
        self._vector[batch.indices] = nanmedian(displacement)
        return Moved(displacement, variance, np.zeros_like(variance))
