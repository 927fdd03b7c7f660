"""Divergence, curl, shear and strain from local fits, medians over the gross contact, and rigid-motion residuals."""

import numpy as np
from numpy.typing import NDArray

from fingerflow.engines.engine import EnteredPoints, FrameEllipse
from fingerflow.ops.fields.rigid_motion import rigid_residual
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.displacement.displacement_stage import DisplacementStage
from fingerflow.pipeline.stages.preparation import plausibility
from fingerflow.pipeline.stages.preparation.series import nanmedian, rate
from fingerflow.pipeline.stages.stage import Batch, RunContext, Stage
from fingerflow.schema.variables import FIELDS
from fingerflow.tracker.deformation import Deformation, Displacement
from fingerflow.tracker.deviations.overlap import OverlapErrors
from fingerflow.tracker.entry import EntryGradients


class FieldsStage(Stage):
    """Stage that fits the displacement gradient at every point in every frame, in reference coordinates."""

    name = "fields"
    gives = FIELDS
    needs = ("views.topography",)
    same_pass = (DisplacementStage,)
    after = (ContactStage,)
    settings = (
        "fields.gauge_length_mm",
        "fields.strain",
        "fields.rate_window_s",
        "tracking.window_px",
        "recording.times",
    )

    def __init__(self, trial: RunContext) -> None:
        super().__init__(trial)
        self._settings = self.inputs.scene.fields
        self._engine = self.inputs.engine
        self._median, self._variance = np.full((2, len(trial), 5), np.nan)
        self._residual, self._known = np.full((2, len(trial)), np.nan)
        self._gauge: dict[str, float | str | int] = {"gauge_length_mm": self._settings.gauge_length_mm}

    def begin(self) -> None:
        moved = self.trial.stage(DisplacementStage)
        self._reference = moved.reference.astype(np.float32)
        self._gauge |= moved.since.attributes(self.inputs.scene.recording.first_frame)
        self._given = ["divergence", "curl", "divergence_std", "curl_std", *({"shear"} & self.trial.requested)]
        for name in self._given:
            self.results.create(name, self._gauge)
        if "rigid_residual" in self.trial.requested:
            self.results.create("rigid_residual")
        minor = self.trial.stage(ContactStage).series["ellipse_semi_axes"][:, 1]
        widest = 2 * float(np.nanmax(minor)) if np.isfinite(minor).any() else np.nan
        self.warnings.extend(plausibility.check_gauge(self._settings.gauge_length_mm, moved.reference, widest))
        # Neighbours by where points were seeded: positions of entry lie on a line.
        positions = moved.common_position if moved.by_onsets else moved.reference
        self._deformation = Deformation(self._engine, positions)
        window_px, scale = self.inputs.scene.tracking.window_px, self.inputs.geometry.topography_mm_per_px
        positions_px = self.inputs.geometry.on_topography(positions)
        errors = OverlapErrors(moved.begins, positions_px, moved.noise, moved.of_onset, moved.by_onsets, window_px)
        self._gain = errors.variance_gain(self._settings.gauge_length_mm / scale)
        self._entry = None
        if len(moved.entered):
            self._entry = EntryGradients(
                *(self._engine, moved.entered, moved.common_position, moved.onset, self._settings.gauge_length_mm),
                moved.onset_variance,
            )

    def step(self, batch: Batch) -> None:
        border = FrameEllipse.from_series(self.trial.stage(ContactStage).series).select(batch.indices)
        displacement, moved = self.trial.stage(DisplacementStage), batch.result(DisplacementStage)
        entered, late = None, np.zeros((2, len(self._reference)))
        if self._entry is not None:
            entered = self._gradients_since_entry(self._entry, batch.indices)  # sets `late` of points that enter
            (xx, xy), (yx, yy) = np.moveaxis(self._entry.late, 0, -1)
            late[:, displacement.entered] = np.square((xx + yy, yx - xy))
        shift = moved.displacement.astype(np.float32)
        variance = moved.variance + moved.curvature
        since = Displacement(self._reference, shift, variance, displacement.of_onset, self._gain, entered, late)
        fields, ranks = self._deformation.add(batch.indices, since, border)
        for name in self._given:
            self.results[name][batch.indices] = getattr(fields, name)
        positions = self.inputs.tensor(self._reference[None])
        residual = rigid_residual(positions, self.inputs.tensor(shift)).cpu().numpy()
        if "rigid_residual" in self.results:
            self.results["rigid_residual"][batch.indices] = residual
        across, down = residual[..., 0], residual[..., 1]  # norms over an axis of two take ten times as long
        self._residual[batch.indices] = nanmedian(np.sqrt(across * across + down * down))
        self._known[batch.indices] = fields.known_share
        self._median[batch.indices] = fields.median
        assert fields.median_std is not None
        self._variance[batch.indices] = fields.median_std**2 + ranks

    def _gradients_since_entry(self, entry: EntryGradients, frames: NDArray[np.intp]) -> EnteredPoints:
        """Return the displacement gradients (n, N, 2, 2) of points that were advected into the contact, each relative
        to its position on entry, with covariances; NaN for all other points.
        """
        displacement = self.trial.stage(DisplacementStage)
        among = np.zeros((len(frames), len(displacement.onset)), dtype=bool)
        among[:, displacement.entered] = True
        gradient = np.full((*among.shape, 2, 2), np.nan, np.float32)
        covariance = np.full((*among.shape, 2, 2, 2, 2), np.nan, np.float32)
        gradient[:, displacement.entered], covariance[:, displacement.entered] = entry.update(
            frames, self.results["position"][frames], displacement.tracked_variance(frames)
        )
        return EnteredPoints(among, gradient, covariance)

    def finish(self) -> None:
        self.results.put("rigid_residual_median", self._residual)
        self.results.put("field_coverage", self._known)
        median_std = np.sqrt(self._variance + self._bias())
        times, window = self.inputs.times, self._settings.rate_window_s
        gross = self.trial.stage(ContactStage).series["gross_contact_area"]
        gauge, first_frame = self._settings.gauge_length_mm, self.inputs.scene.recording.first_frame
        self.warnings.extend(plausibility.check_fields(self._median[:, 0], self._known, gross, gauge, first_frame))
        self.results.put("median_divergence", self._median[:, 0], self._gauge)
        self.results.put("median_divergence_std", median_std[:, 0])
        self.results.put("median_curl", self._median[:, 1], self._gauge)
        self.results.put("median_curl_std", median_std[:, 1])
        self.results.put("median_strain", self._median[:, 2:], self._gauge | {"measure": self._settings.strain})
        self.results.put("median_strain_std", median_std[:, 2:])
        rates, rates_std = rate(self._median, times, window), rate(median_std, times, window, of_std=True)
        self.results.put("median_divergence_rate", rates[:, 0])
        self.results.put("median_divergence_rate_std", rates_std[:, 0])
        self.results.put("median_strain_rate", rates[:, 2:])
        self.results.put("median_strain_rate_std", rates_std[:, 2:])

    def _bias(self) -> NDArray[np.float64]:
        """Return the variance (frames, 5) of the medians by gauge length and border, interpolated between the evaluated
        frames, as skin and contact change slowly.

        Where a contact is too small for twice the gauge length, the nearest frame in which it is large enough is used;
        NaN if there is none.
        """
        result, frames = np.full(self._variance.shape, np.nan), np.arange(len(self._variance))
        for column, values in enumerate(result.T):
            evaluated = [(frame, bias[column]) for frame, bias in self._deformation.bias if np.isfinite(bias[column])]
            if evaluated:
                number, variance = np.array(evaluated).T
                values[:] = np.interp(frames, number, variance)
        return result
