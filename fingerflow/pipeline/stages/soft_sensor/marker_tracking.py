"""Conversion of the tracked markers of a soft sensor to the result variables of tracked points."""

import numpy as np
from numpy.typing import NDArray

from fingerflow.kernels.tracking_limits import TrackStatus
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.soft_sensor.marker_contact import CELL_PX
from fingerflow.pipeline.stages.soft_sensor.sensor_markers import MarkerStage
from fingerflow.pipeline.stages.stage import Batch, RunContext, Stage
from fingerflow.pipeline.stages.tracking.tracking_stage import TrackingStage
from fingerflow.schema.variables import TRACKING


class MarkerTrackingStage(TrackingStage):
    """Stage that stores markers found by `MarkerStage` as tracked points.

    A marker is detected in each frame independently, so there is no forward-backward error.
    """

    name = "marker_tracking"
    instead = True
    views = ()
    after = (MarkerStage,)
    reads_frames = False
    settings = ("calibration.mm_per_px", "calibration.topography_to_contact")

    def __init__(self, trial: RunContext) -> None:
        Stage.__init__(self, trial)
        self._share = np.full(len(trial), np.nan)

    @property
    def backward(self) -> bool:
        return False

    def begin(self) -> None:
        self._markers = self.trial.stage(MarkerStage)
        for variable in TRACKING:
            if "point" in variable.dims and self.trial.stores(variable):
                self.results.create(variable.name, point=self._markers.points.shape[1])
        self._last = np.where(np.isfinite(self._markers.rest), self._markers.rest, -1.0)

    def step(self, batch: Batch) -> None:
        markers, frames = self._markers, batch.indices
        pixels, status = markers.points[frames], markers.status[frames]
        touches = np.zeros(status.shape, dtype=bool)
        for k, cells in enumerate(batch.of(ContactStage)):
            self._last = np.where(np.isfinite(pixels[k]), pixels[k], self._last)
            touches[k] = _inside(cells, self._last)
        variance = np.trace(markers.covariance[frames], axis1=-2, axis2=-1) / 2
        for name, values in {
            "position": self.inputs.on_glass(pixels),
            "position_px": pixels,
            "position_std_px": np.sqrt(variance),
            "position_noise_px": np.sqrt(variance),  # a marker has no window that skin bends
            "deformation_correction_px": np.zeros(pixels.shape),  # 0, since a marker has no window
            "subset_correlation": np.full(status.shape, np.nan),  # NaN, for the same reason
            "forward_backward_error": np.full(status.shape, np.nan),
            "status": status,
            "in_contact": touches,
        }.items():
            if name in self.results:
                self.results[name][frames] = values
        self._share[frames] = (status == TrackStatus.TRACKED).mean(1)

    def finish(self) -> None:
        self.results.put("tracked_share", self._share)
        self.results.put("window_differs_share", np.zeros(len(self._share)))  # 0, since a marker has no window
        self.results.put("forward_backward_median", np.full(len(self._share), np.nan))


def _inside(cells: NDArray[np.bool_], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask of the points (N, 2) px that lie in cells (h, w) of the contact region."""
    column, row = np.floor((points + 0.5) / CELL_PX).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < cells.shape[1]) & (row < cells.shape[0])
    result: NDArray[np.bool_] = inside & cells[np.where(inside, row, 0), np.where(inside, column, 0)]
    return result
