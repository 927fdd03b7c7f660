"""Strain and strain energy as the lab of Willemet et al. (2021) counts them, for comparison with that paper."""

import numpy as np
import torch

from fingerflow.kernels.arrays import nanmedian
from fingerflow.ops.fields.strain import green_lagrange, strain_energy_density
from fingerflow.ops.fields.triangles import triangle_areas, triangle_gradients
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.deformation.deformation_stage import DeformationStage
from fingerflow.pipeline.stages.stage import Batch, Stage
from fingerflow.pipeline.stages.strain.counted_skin import triangulate
from fingerflow.schema.variables import PRINTED_STRAIN


class PrintedStrainStage(Stage):
    """Stage that computes strain and energy since the first frame with contact, as every version of the lab's script.

    Triangles are those of all points that come into contact, by their positions in that frame. Their strains are raw:
    no share of noise is subtracted, and skin between the outermost points and the border counts nothing. Skin moves
    before the contact reaches it, which `StrainStage` does not count by default.
    """

    name = "printed_strain"
    gives = PRINTED_STRAIN
    needs = ("views.topography",)
    after = (ContactStage, DeformationStage)
    settings = ("fields.strain", "fields.young_modulus_mpa", "fields.poisson_ratio", "fields.depth_mm")

    def begin(self) -> None:
        self._moved = self.trial.stage(DeformationStage)
        self.about["printed_strain"] = {"measure": self.inputs.scene.fields.strain}
        first = np.flatnonzero(self.results["gross_contact_area"][:] > 0)[:1]
        reference = np.where(self._moved.onset[:, None] >= 0, self._moved.steady_position[first].sum(0), np.nan)
        self._triangles = triangulate(reference)
        self._corners, self._reference = torch.from_numpy(self._triangles).long(), torch.from_numpy(reference)[None]
        self._areas = triangle_areas(self._reference, self._corners)[0].numpy()

    def step(self, batch: Batch) -> None:
        settings, position = self.inputs.scene.fields, self._moved.steady_position[batch.indices]
        gradient = triangle_gradients(self._reference, self._corners, torch.from_numpy(position) - self._reference)
        strain = green_lagrange(gradient, settings.strain)
        density = strain_energy_density(strain, settings.young_modulus_mpa, settings.poisson_ratio).numpy()
        inside = np.all(self.results["in_contact"][batch.indices][:, self._triangles], axis=-1)[..., None]
        energy = settings.depth_mm * np.where(inside[..., 0], density * self._areas, np.nan)
        values = {
            "printed_strain": nanmedian(np.where(inside, strain.numpy(), np.nan)),
            "printed_strain_energy": np.where(np.isfinite(energy).any(1), np.nansum(energy, axis=1), np.nan),
        }
        for name, series in self.series.items():
            series[batch.indices] = values[name]
