"""Divergence, curl and strain by local fits, and their medians over the gross contact."""

import numpy as np
import torch

from fingerflow.graphs import FieldsGraph, GrossEllipse
from fingerflow.player.contract.variables import FIELDS
from fingerflow.stages.contact import ContactStage
from fingerflow.stages.displacement import DisplacementStage, Moved
from fingerflow.stages.series import rate
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
        self._graph = self.inputs.engine(FieldsGraph(self._settings.gauge_length_mm, self._settings.strain))
        self._median, self._median_std = np.full((2, len(trial), 5), np.nan)
        self._gauge = {"gauge_length_mm": self._settings.gauge_length_mm}

    def begin(self) -> None:
        self._reference = self.inputs.tensor(self.trial.stage(DisplacementStage).reference)[None]
        for name in ("divergence", "curl", "divergence_std", "curl_std"):
            self.results.create(name, self._gauge)

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
        for name in ("divergence", "curl", "divergence_std", "curl_std"):
            self.results[name][batch.indices] = getattr(found, name).cpu().numpy()
        self._median[batch.indices] = torch.Tensor.cpu(found.median)
        self._median_std[batch.indices] = torch.Tensor.cpu(found.median_std)

    def finish(self) -> None:
        times, window = self.inputs.times, self._settings.rate_window_s
        for name, columns, has_rate in _MEDIANS:
            measure = {"measure": self._settings.strain} if name == "strain" else {}
            median = self._median[:, columns]
            self.results.put(f"median_{name}", median, self._gauge | measure)
            self.results.put(f"median_{name}_std", self._median_std[:, columns])
            if has_rate:
                self.results.put(f"median_{name}_rate", rate(median, times, window))
