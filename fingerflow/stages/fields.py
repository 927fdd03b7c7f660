"""Divergence, curl, shear and strain by local fits, their medians over the gross contact, and what is not rigid."""

import numpy as np

from fingerflow.graphs import FieldsGraph, GrossEllipse
from fingerflow.ops.rigid_motion import rigid_residual
from fingerflow.player.contract.variables import FIELDS
from fingerflow.stages import plausibility
from fingerflow.stages.contact import ContactStage
from fingerflow.stages.displacement import DisplacementStage, Moved
from fingerflow.stages.series import nanmedian, rate
from fingerflow.stages.stage import Batch, Stage, Trial

_MEDIANS = (  # columns of `FieldsGraph`'s medians: name, which, whether it has a rate
    ("divergence", 0, True),
    ("curl", 1, False),
    ("strain", slice(2, 5), True),
)


class FieldsStage(Stage):
    """Fits in reference coordinates, frame by frame."""

    name = "fields"
    gives = FIELDS
    needs = ("views.topography",)
    beside = (DisplacementStage,)
    after = (ContactStage,)

    def __init__(self, trial: Trial) -> None:
        super().__init__(trial)
        self._settings = self.inputs.scene.fields
        self._graph = self.inputs.engine(FieldsGraph(self.inputs.gauge_length_mm, self._settings.strain))
        self._median, self._median_std = np.full((2, len(trial), 5), np.nan)
        self._residual, self._known = np.full((2, len(trial)), np.nan)
        self._gauge: dict[str, float | str | int] = {"gauge_length_mm": self.inputs.gauge_length_mm}

    def begin(self) -> None:
        self._reference = self.inputs.tensor(self.trial.stage(DisplacementStage).reference)[None]
        self._gauge |= self.trial.stage(DisplacementStage).since.attributes(self.inputs.scene.recording.first_frame)
        self._given = ["divergence", "curl", "divergence_std", "curl_std", *({"shear"} & self.trial.asked)]
        for name in self._given:
            self.results.create(name, self._gauge)
        if "rigid_residual" in self.trial.asked:
            self.results.create("rigid_residual")
        minor = self.trial.stage(ContactStage).series["ellipse_semi_axes"][:, 1]
        widest = 2 * float(np.nanmax(minor)) if np.isfinite(minor).any() else np.nan
        points = self.trial.stage(DisplacementStage).reference
        self.inputs.warnings.extend(plausibility.of_gauge(self.inputs.gauge_length_mm, points, widest))

    def step(self, batch: Batch) -> None:
        contact, displacement = self.trial.stage(ContactStage).series, self.trial.stage(DisplacementStage)
        moved: Moved = batch.of(DisplacementStage)
        ellipse = GrossEllipse(
            *(
                self.inputs.tensor(contact[f"ellipse_{name}"][batch.indices])
                for name in ("center", "semi_axes", "angle")
            )
        )
        found = self._graph(
            self._reference,
            self.inputs.tensor(moved.displacement),
            self.inputs.tensor(displacement.covariance(moved)),
            ellipse,
        )
        for name in self._given:
            self.results[name][batch.indices] = getattr(found, name).cpu().numpy()
        residual = rigid_residual(self._reference, self.inputs.tensor(moved.displacement)).cpu().numpy()
        if "rigid_residual" in self.results:
            self.results["rigid_residual"][batch.indices] = residual
        self._residual[batch.indices] = nanmedian(np.linalg.norm(residual, axis=-1))
        assert found.median is not None
        assert found.median_std is not None
        assert found.known_share is not None
        self._known[batch.indices] = found.known_share.cpu()
        self._median[batch.indices] = found.median.cpu()
        self._median_std[batch.indices] = found.median_std.cpu()

    def finish(self) -> None:
        self.results.put("rigid_residual_median", self._residual)
        self.results.put("field_coverage", self._known)
        times, window = self.inputs.times, self._settings.rate_window_s
        for name, columns, has_rate in _MEDIANS:
            measure = {"measure": self._settings.strain} if name == "strain" else {}
            median = self._median[:, columns]
            self.results.put(f"median_{name}", median, self._gauge | measure)
            self.results.put(f"median_{name}_std", self._median_std[:, columns])
            if has_rate:
                self.results.put(f"median_{name}_rate", rate(median, times, window))
