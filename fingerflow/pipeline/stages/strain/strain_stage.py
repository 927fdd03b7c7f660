"""Strain of the triangles between tracked points, and strain energy of the skin in contact."""

import numpy as np
import torch
from scipy.sparse import coo_array, eye_array

from fingerflow.kernels.array_types import Array, Mask, Numbers, Series
from fingerflow.kernels.result_records import FrameEllipse
from fingerflow.ops.fields.local_fit import local_gradients
from fingerflow.ops.fields.strain import principal_deviations, principal_strains, strain_energy_density_std
from fingerflow.ops.fields.triangle_strain import TriangleStrain, triangle_strain
from fingerflow.ops.fields.triangles import triangle_areas
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.deformation.deformation_stage import DeformationStage
from fingerflow.pipeline.stages.preparation import plausibility
from fingerflow.pipeline.stages.preparation.series import rate
from fingerflow.pipeline.stages.stage import Batch, Stage
from fingerflow.pipeline.stages.strain.contact_energy import GROWTH_MM, ContactEnergy, perimeter
from fingerflow.pipeline.stages.strain.counted_skin import CountedSkin
from fingerflow.pipeline.stages.strain.steady_border import steady_border
from fingerflow.schema.variables import STRAIN
from fingerflow.tracker.contact_border import BORDER_MM
from fingerflow.tracker.deviations.onset_time import displacement_covariance
from fingerflow.tracker.deviations.overlap import OverlapErrors
from fingerflow.tracker.recorded.missing_energy import MissingEnergy

# Share of the strain energy that the triangles lack, beside a field which resolves the border, that lies inside them:
# RMS over four presses of synthetic skin at half to twice the usual deformation.
_INSIDE = 0.3
# Windows, gauge length over which displacements are smoothed again, to see what a window has taken from the energy.
_SMOOTHED = 2.5
# Energy that windows have taken, over what they would have by the share that smoothing again takes: RMS over the frames
# of four slides and two partial slips of other seeds and ways than those of the tables.
_TAKEN = 0.33

_USUAL = 4  # third differences of a triangle's strain that count as much as what is usual
# Share of the variance by errors of onset that is left in triangles: neighbours share the rest, and triangles that
# large errors distort count from one frame. Measured on presses of real prints.
_KEPT = 0.5
_ENERGIES = "strain_energy", "strain_energy_std", "strain_energy_between_points", "strain_energy_between_points_std"


class StrainStage(Stage):
    """Stage that computes strain and strain energy on Delaunay triangles between the reference positions of the points.

    The energy of all skin in contact is that of a smooth field (`contact_energy`) where displacement counts from the
    onset and such a field explains it. Elsewhere, as on a slide, it is the sum over the triangles, and the skin between
    them and the border has the density of the triangles beside it.

    The sum over triangles is that of triangles that have touched as a whole and have two or more corners in the contact
    now, as skin that has left it keeps its strain. The mean contribution of errors of points is subtracted. Skin
    between the outermost points and the border is in no triangle: on the simulated press, with 700 points, it has a
    sixth of the energy at the end and a quarter to a half of it before.
    """

    name = "strain"
    gives = STRAIN
    needs = ("views.topography",)
    same_pass = (DeformationStage,)
    after = (ContactStage,)
    settings = (
        *("fields.strain", "fields.young_modulus_mpa", "fields.poisson_ratio", "fields.depth_mm"),
        *("fields.gauge_length_mm", "fields.rate_window_s", "tracking.window_px", "recording.times"),
    )

    def begin(self) -> None:
        self._settings = self.inputs.scene.fields
        self._elastic = self._settings.young_modulus_mpa, self._settings.poisson_ratio
        self._energy, self._energy_std, self._between, self._between_std = [self.series[name] for name in _ENERGIES]
        self._misfit = np.zeros(len(self.trial), bool)
        self.warnings += plausibility.check_young_modulus(self._settings.young_modulus_mpa)
        moved, device = self.trial.stage(DeformationStage), self.inputs.device
        skin = self._skin = CountedSkin(moved, self.results, len(self.trial))
        self._since = moved.attributes
        measure = {"measure": self._settings.strain} | self._since
        self.results.put("triangles", skin.triangles, triangle=len(skin.triangles), corner=3)
        self._principal = {name for name in self.trial.requested if name.startswith("principal_")}
        density = "strain_energy_density", "strain_energy_density_std"
        for name in ("strain", "strain_std", *density, *sorted(self._principal)):
            self.results.create(name, self._since if "energy" in name else measure)
        self._reference = self.inputs.tensor(skin.reference)[None]
        corners = torch.from_numpy(skin.corners).long()
        # A triangle with a corner that was lost when it touched has no area, and no strain.
        self._areas = triangle_areas(torch.from_numpy(skin.reference)[None], corners)[0].nan_to_num(0.0).numpy()
        self._corners = corners.to(device)
        known = skin.since, skin.positions_px, skin.noise, skin.of_onset, skin.by_onsets
        errors = OverlapErrors(*known, self.inputs.scene.tracking.window_px)
        pairs = errors.pairs()
        sides = [errors.between(skin.corners[:, k], skin.corners[:, (k + 1) % 3]) for k in range(3)]
        shared = np.stack(sides, axis=1), pairs, errors.between(*pairs.T)
        self._shared = tuple(torch.from_numpy(values).to(device) for values in shared)
        self._missing = MissingEnergy(self._areas)
        # Energy lacks a faint rim of the contact and, of the rest, the displacement before the later onset.
        faint_mm = 2 * self.trial.stage(ContactStage).faint_rim_mm
        self._border_mm = np.hypot(BORDER_MM, faint_mm)
        points, (first, second) = len(moved.onset), pairs[(pairs < len(moved.onset)).all(1)].T
        upper = coo_array((errors.between(first, second), (first, second)), (points, points))
        correlations = (upper + upper.T + eye_array(points)).tocsr()
        self._whole = ContactEnergy(self._settings.strain, self._elastic, correlations, faint_mm)
        self._border = steady_border(moved.border, self.inputs.times)
        # Smoothing over time delays the frame in which the border stops.
        self._grown = _growth(np.sqrt(moved.border.semi_axes.prod(1)))
        # Skin that touches from the first frame on has no onset: its displacement need not vanish at the border.
        areas = self.results["gross_contact_area"][:]
        self._begins_free = bool((areas[np.isfinite(areas)][:1] == 0).all())
        # Later onsets on the border of a slide have other references, so that displacements jump there.
        begins = skin.since[: len(moved.onset)]
        here = np.pad(begins == begins[begins >= 0].min(initial=len(self.trial)), (0, len(skin.since) - len(begins)))
        self._from_start = self.inputs.tensor(np.where(here[:, None], skin.reference, np.nan))[None]
        self._window_mm = self.inputs.scene.tracking.window_px * self.inputs.geometry.topography_mm_per_px

    def step(self, batch: Batch) -> None:
        moved, noise, curvature = self._skin.moved(batch.steps[DeformationStage], batch.indices)
        touching = self._sum_corners(self.results["in_contact"][batch.indices].astype(np.uint8)) >= 2
        touching &= (batch.indices[:, None] >= self._skin.begins) & (batch.indices[:, None] < self._skin.ends)
        # The energy is corrected for that of image noise. Curvature makes strains too small rather than noisy: it only
        # counts in the deviations.
        of_onset = _KEPT * self._skin.of_onset
        covariance = displacement_covariance(noise, self._skin.independent[:, None, None] * of_onset)
        whole = displacement_covariance(noise + curvature, of_onset, self._skin.shape)
        displacement = self.inputs.tensor(moved)
        corrected = self._triangle_strain(displacement, covariance, touching)
        stated = self._triangle_strain(displacement, whole, touching)
        density_std = strain_energy_density_std(corrected.strain, stated.strain_std, *self._elastic)
        values = {"strain": corrected.strain, "strain_std": stated.strain_std}
        values |= {"strain_energy_density": corrected.density, "strain_energy_density_std": density_std}
        if self._principal:
            values["principal_strains"], values["principal_angle"] = principal_strains(corrected.strain)
            deviations = principal_deviations(corrected.strain, stated.strain_std)
            values["principal_strains_std"], values["principal_angle_std"] = deviations
        for name, computed in values.items():
            if name in self.results:
                self.results[name][batch.indices] = computed.cpu().numpy()
        deviation = stated.energy_std.cpu().numpy()
        if self.inputs.scene.tracking.template == "previous":
            # Errors that add up cancel in part, so that of what is taken for noise some is strain.
            raw = self._triangle_strain(displacement, 0 * covariance, touching)
            deviation = np.hypot(deviation, (raw.energy - corrected.energy).cpu().numpy())
        if not self._begins_free:
            deviation = np.hypot(deviation, _TAKEN * self._lost_by_smoothing(moved, corrected.energy, touching))
        self._sum_up(batch, touching, corrected.density.cpu().numpy(), corrected.energy.cpu().numpy(), deviation)

    def _triangle_strain(self, moved: torch.Tensor, covariance: Array, touching: Mask) -> TriangleStrain:
        contact = torch.from_numpy(touching).to(self.inputs.device)
        given = self._reference, self._corners, moved, self.inputs.tensor(covariance), contact, self._shared
        young, poisson = self._elastic
        return triangle_strain(*given, measure=self._settings.strain, young_modulus_mpa=young, poisson_ratio=poisson)

    def _lost_by_smoothing(self, moved: Array, energy: torch.Tensor, touching: Mask) -> Array:
        """Return by how much smoothing has lowered the strain energies `energy` (n,) of n frames, free of that of image
        noise, if it took as large a share as smoothing the displacements `moved` (n, P, 2) mm over `_SMOOTHED` windows
        takes of what is left, two thirds at most.

        A window averages the displacement over itself, which takes energy away at the edge of slip (`_TAKEN`). It
        counts where skin touches from the first frame on: the energy of a growing contact is that of a field which is
        not averaged (`contact_energy`).
        """
        displacement = self.inputs.tensor(moved)
        smooth = local_gradients(self._from_start, displacement, gauge_length=_SMOOTHED * self._window_mm).value
        again = torch.where((smooth + displacement).isfinite(), smooth, displacement)
        left = self._triangle_strain(again, np.zeros((*moved.shape, 2), np.float32), touching).energy
        lost = (energy - left).clamp_min(0) * energy / torch.maximum(left, energy / 3 + 1e-30)
        return lost.cpu().numpy()

    def _sum_up(self, batch: Batch, touching: Mask, density: Array, between: Series, between_std: Series) -> None:
        """Store the strain energies of a batch of frames and their standard deviations: `between`, the sum over the
        triangles between points, and that of all skin in contact.
        """
        frames, border = batch.indices, self._border.select(batch.indices)
        stage = self.trial.stage(DeformationStage)
        steady = stage.steady_position
        position, moved = steady[frames], batch.steps[DeformationStage]
        # Skin that was in contact when its points were seeded has no strain, and that of the rest is not its own.
        seen = self.results["in_contact"][frames] & np.isfinite(position[..., 0])
        unknown = 2 * (seen & np.isfinite(moved.displacement[..., 0])).sum(1) < seen.sum(1)
        between, between_std = (np.where(unknown, np.nan, values) for values in (between, between_std))
        reach_mm, centroids = self._settings.gauge_length_mm / 2, self._sum_corners(position) / 3
        border_energy = border_density(np.where(touching, density, np.nan), self._areas, centroids, border, reach_mm)
        # Where no triangle lies near the border, an error of the border changes no triangle that counts.
        strip = np.nan_to_num(self._border_mm * perimeter(border.semi_axes) * border_energy)
        # Tracking corrects for the second derivatives of the displacement within a window. The fourth ones are left.
        blur = np.nan_to_num(self._window_mm / (2 * border.semi_axes.min(1))) ** 4
        errors = (between_std, self._missing.add_frames(density, touching), strip, blur * between)
        deviation = np.linalg.norm(errors, axis=0)
        self._between[frames], self._between_std[frames] = between, deviation
        rim = border_energy * self._rim_area(position, touching, border)
        self._energy[frames], self._energy_std[frames] = between + rim, np.hypot(deviation, rim / 2)
        rim = np.nan_to_num(rim)
        # Points count where displacement is relative to the onset of contact. Where too few triangles are known for a
        # sum, points are too few for a field.
        counts = self.results["in_contact"][frames] & (stage.onset >= 0) & (frames[:, None] >= stage.onset)
        counts[:, stage.entered] = False
        counts &= stage.by_onsets and self._begins_free
        counts &= np.isfinite(between)[:, None]
        variance = moved.variance + np.trace(stage.of_onset, axis1=1, axis2=2) / 2

        def since_growth(rows: Numbers) -> Series:
            grown, number = np.unique(self._grown[frames[rows]], return_inverse=True)
            then = np.concatenate([steady[run] for run in np.split(grown, (np.diff(grown) > 1).nonzero()[0] + 1)])
            return position[rows] - then[number]

        whole = self._whole.estimate(frames, position, moved.displacement, variance, counts, border, since_growth)
        fitted = np.isfinite(whole.energy)
        # The field resolves strain that rises towards the border, triangles do not: what they lack in all.
        lacking = whole.energy[fitted] - (between + rim)[fitted]
        doubt = 1 - whole.trust[fitted]
        self._energy[frames[fitted]] = whole.energy[fitted] - doubt * lacking
        self._misfit[frames] = whole.trust < 1
        # Skin that has moved at the border leaves its displacement there to be extrapolated: both energies then err.
        by_border = np.hypot(np.maximum(whole.moves[fitted], doubt) * lacking, (blur * whole.energy)[fitted])
        self._energy_std[frames[fitted]] = np.hypot(whole.deviation[fitted], by_border)
        # Where they have more than the field, single triangles are wrong, as of points whose onset is detected late.
        self._between_std[frames[fitted]] = np.hypot(deviation[fitted], np.where(lacking < 0, 1.0, _INSIDE) * lacking)

    def _rim_area(self, position: Series, touching: Mask, border: FrameEllipse) -> Series:
        """Return, per frame (n,), the contact area in mm^2 that no triangle in contact covers."""
        # By components: gathering pairs of numbers takes twice as long.
        first, second, third = (position.transpose(2, 0, 1).take(corner, axis=2) for corner in self._skin.triangles.T)
        (ax, ay), (bx, by) = second - first, third - first
        areas = abs(ax * by - ay * bx) / 2
        inside = np.where(touching, np.where(np.isfinite(areas), areas, self._areas), 0.0).sum(1)
        return np.fmax(np.pi * border.semi_axes.prod(1) - inside, 0.0)

    def _sum_corners(self, values: Array) -> Array:
        """Return the sum (n, M, ...) of values at points (n, N, ...) over the three corners of each triangle.

        Corners are added one by one, as sums over an axis of three take longer.
        """
        first, second, third = (values.take(corner, axis=1) for corner in self._skin.triangles.T)
        return first + second + third

    def finish(self) -> None:
        gross, depth = self.results["gross_contact_area"][:], self._settings.depth_mm
        gauge_mm = self._settings.gauge_length_mm
        self.warnings += plausibility.check_energy(gross, self._misfit, gauge_mm, self.first_frame)
        for name in _ENERGIES:
            # The energy is 0 without contact, and NaN with contact if no triangle of it is known.
            self.series[name] = np.where(gross == 0, 0.0, depth * self.series[name])
            self.about[name] = {"depth_mm": depth} | self._since
        self.series["strain_energy_rate"] = self._rate(self.series["strain_energy"])
        self.series["strain_energy_rate_std"] = self._rate(self.series["strain_energy_std"], of_std=True)
        if "strain_rate" in self.trial.requested:
            self._put_strain_rate()

    def _rate(self, series: Series, of_std: bool = False) -> Series:
        return rate(series, self.inputs.times, self._settings.rate_window_s, of_std)

    def _put_strain_rate(self) -> None:
        """Store the strain rate of the triangles, whose errors are noise from frame to frame, which third differences
        show free of any parabola, and the growth of the errors that frames share.

        Triangles known in few frames have few differences: `_USUAL` more are taken as usual for their deviation.
        """
        strain, deviation = (self.results[name][:].astype(np.float64) for name in ("strain", "strain_std"))
        third, stated = np.diff(strain, 3, axis=0) ** 2 / 20, np.fmax.reduce(deviation) ** 2
        count = np.isfinite(third).sum(0)
        usual = np.nansum(third) / (np.nansum(count * stated) or np.nan) * stated
        noise = np.sqrt((np.nansum(third, 0) + _USUAL * usual) / (count + _USUAL))
        by_noise = self._rate(np.where(np.isfinite(strain), noise, np.nan), of_std=True)
        self.results.put("strain_rate", self._rate(strain))
        self.results.put("strain_rate_std", np.hypot(by_noise, self._rate(deviation)))


def border_density(density: Array, areas: Array, positions: Array, border: FrameEllipse, reach_mm: float) -> Series:
    """Return the mean strain energy density (n,), mJ/mm^3, in n frames of the triangles that lie within `reach_mm` of
    the contact border, weighted by area.

    It is NaN in frames without such triangles. Strain since the onset is largest along the border of a growing contact,
    where skin that has moved lies beside skin that has just come into contact. A border that is displaced all around
    changes the onset of the outermost points and the set of triangles that count.

    Args:
        density: (n, M) mJ/mm^3, NaN for triangles that do not count.
        areas: (M,) mm^2.
        positions: (n, M, 2) mm, centroids of the triangles.
        border: of these n frames.
        reach_mm: width of the zone that is averaged.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.where((border.inside(positions) < reach_mm) & np.isfinite(density), areas, 0.0)
        total, weight = (values.sum(1, dtype=np.float64) for values in (weights * np.nan_to_num(density), weights))
        return total / weight


def _growth(radius: Series) -> Numbers:
    """Return, for each frame, the first of the frames up to it in which the mean radius (n,) mm of the contact has been
    within `GROWTH_MM` of its value there, or larger.
    """
    sizes = np.where(np.isfinite(radius), radius, -np.inf)
    smaller = (np.flatnonzero(sizes[:frame] < size - GROWTH_MM) for frame, size in enumerate(sizes))
    return np.array([1 + frames.max(initial=-1) for frames in smaller], np.intp)
