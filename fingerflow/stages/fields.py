"""Divergence, curl, shear and strain by local fits, their medians over the gross contact, and what is not rigid."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.graphs import FieldsGraph, GrossEllipse
from fingerflow.graphs.fields import Fields
from fingerflow.ops.area_medians import Apart, area_medians
from fingerflow.ops.rigid_motion import rigid_residual
from fingerflow.ops.strain import curl, divergence, green_lagrange, shear
from fingerflow.ops.strain_uncertainty import field_sensitivity
from fingerflow.player.contract.variables import FIELDS
from fingerflow.stages import plausibility
from fingerflow.stages.border import Border
from fingerflow.stages.contact import ContactStage
from fingerflow.stages.displacement import DisplacementStage, Moved
from fingerflow.stages.entered_skin import EntryGradients
from fingerflow.stages.median_bias import MedianBias
from fingerflow.stages.series import nanmedian, rate
from fingerflow.stages.stage import Batch, Stage, Trial

_AT_ONCE = 8  # frames, where medians are of skin of two kinds: 800 positions and all points in each
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
    settings = ("fields.gauge_length_mm", "fields.strain", "fields.rate_window_s", "recording.times")

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
        self.warnings.extend(plausibility.of_gauge(self.inputs.gauge_length_mm, points, widest))

        moved = self.trial.stage(DisplacementStage)
        self._bias = MedianBias(len(self.trial), self.inputs.gauge_length_mm, self._settings.strain, moved)
        self._entry = None
        if len(moved.entered):
            self._entry = EntryGradients(moved.entered, moved.places, moved.onset, self.inputs.gauge_length_mm)

    def step(self, batch: Batch) -> None:
        contact, displacement = self.trial.stage(ContactStage).series, self.trial.stage(DisplacementStage)
        moved: Moved = batch.of(DisplacementStage)
        ellipse = GrossEllipse(*map(self.inputs.tensor, Border.of(contact).at(batch.indices)))
        covariance = self.inputs.tensor(displacement.covariance(moved))
        if self._entry is None:
            apart, rest = None, self.inputs.tensor(moved.displacement)
            found = self._graph(self._reference, rest, covariance, ellipse)
        else:
            found, apart, rest = self._with_entered(self._entry, batch.indices, moved, covariance, ellipse)
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
        self._bias.look(batch, found, rest, ellipse, apart)

    def _with_entered(
        self, entry: EntryGradients, frames: NDArray[np.intp], moved: Moved, covariance: Tensor, ellipse: GrossEllipse
    ) -> tuple[Fields, Apart, Tensor]:
        """Fields of skin that moved into the contact since its entry, of the rest without it, and medians of both; what
        they take of the one kind, and the displacement (n, N, 2) of the other.
        """
        device, measure = self.inputs.device, self._settings.strain
        displacement = self.inputs.tensor(moved.displacement)
        touching = displacement[:, entry.entered].isfinite().all(-1)
        rest = displacement.clone()
        rest[:, entry.entered] = torch.nan
        found: Fields = self._graph(self._reference, rest, covariance)
        position = self.results["position"][frames]
        variance = self.trial.stage(DisplacementStage).tracked_variance(frames)
        since = entry.at(frames, position, variance)
        known = touching.cpu()[..., None, None]
        gradient = torch.where(known, since.gradient, torch.nan)
        sensitivity = field_sensitivity(gradient, measure)[..., None, None]
        spread = (sensitivity * since.covariance[:, :, None]).sum((-4, -3))
        std = (spread * sensitivity[..., 0, 0]).sum((-2, -1)).clamp_min(0).sqrt()
        fields = torch.cat(
            (divergence(gradient)[..., None], curl(gradient)[..., None], green_lagrange(gradient, measure)), dim=-1
        )
        place = np.where(np.isfinite(fields[..., :1].numpy()), position[:, entry.entered], np.nan)
        for values, own in (
            (found.divergence, fields[..., 0]),
            (found.curl, fields[..., 1]),
            (found.shear, shear(gradient)),
            (found.strain, fields[..., 2:]),
            (found.divergence_std, std[..., 0]),
            (found.curl_std, std[..., 1]),
        ):
            assert values is not None
            values[:, entry.entered] = own.to(values)
        apart = Apart(*(self.inputs.tensor(one) for one in (place, fields.numpy(), std.numpy())))
        medians = [
            area_medians(
                self._reference,
                rest[some],
                *(one[some] for one in ellipse),
                gauge_length=self.inputs.gauge_length_mm,
                measure=measure,
                covariance=covariance[some],
                apart=Apart(*(one[some] for one in apart)),
            )
            for some in torch.arange(len(frames), device=device).split(_AT_ONCE)
        ]
        median, median_std, share = (torch.cat(parts) for parts in zip(*medians, strict=True))
        return found._replace(median=median, median_std=median_std, known_share=share), apart, rest

    def finish(self) -> None:
        self.results.put("rigid_residual_median", self._residual)
        self.results.put("field_coverage", self._known)
        self._median_std = np.sqrt(self._median_std**2 + self._bias.square())
        times, window = self.inputs.times, self._settings.rate_window_s
        for name, columns, has_rate in _MEDIANS:
            measure = {"measure": self._settings.strain} if name == "strain" else {}
            median = self._median[:, columns]
            self.results.put(f"median_{name}", median, self._gauge | measure)
            self.results.put(f"median_{name}_std", self._median_std[:, columns])
            if has_rate:
                self.results.put(f"median_{name}_rate", rate(median, times, window))
