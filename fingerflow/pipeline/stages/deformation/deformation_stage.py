"""Displacement of each point, counted from the point's onset of contact or from one frame common to all points; its
fields by local fits, and medians over the gross contact.
"""

from typing import ClassVar

import numpy as np

from fingerflow.engines.engine import FrameEllipse
from fingerflow.kernels.array_types import Array, Numbers, Points
from fingerflow.kernels.arrays import nanmedian
from fingerflow.kernels.field_limits import LEAST_SHARE
from fingerflow.ops.fields.rigid_motion import rigid_residual
from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.pipeline.stages.preparation import plausibility
from fingerflow.pipeline.stages.preparation.frame_check import FrameCheckStage
from fingerflow.pipeline.stages.preparation.inputs import resolve_reference
from fingerflow.pipeline.stages.preparation.series import rate
from fingerflow.pipeline.stages.stage import Batch, Stage
from fingerflow.pipeline.stages.tracking.tracking_stage import TrackingStage
from fingerflow.schema.variables import DISPLACEMENT, ENTRY, FIELDS
from fingerflow.tracker.area_steps import check_beginning, second_touches
from fingerflow.tracker.deformation import Deformation, Displacement, SkinFrames
from fingerflow.tracker.deviations.image_noise import noise_variance
from fingerflow.tracker.deviations.onset_time import onset_errors
from fingerflow.tracker.deviations.overlap import OverlapErrors
from fingerflow.tracker.deviations.rigid_residual import residual_deviations
from fingerflow.tracker.displacement_medians import displacement_length
from fingerflow.tracker.entry import EntryGradients, advected, variance_of_late
from fingerflow.tracker.onset import Touches, Touching
from fingerflow.tracker.recorded.common_frame import common_frame
from fingerflow.tracker.recorded.stored_frames import runs_of_frames, values_at
from fingerflow.tracker.recorded.unseen_touch import UnseenTouches
from fingerflow.tracker.vibration import SteadyPositions, steady, vibration


class DeformationStage(Stage):
    """Stage that measures the displacement of each point from a reference position, and the displacement gradient at
    every point, in reference coordinates. It knows the onsets of the whole recording (`tracker.deformation.Onsets`).

    `fields.reference` selects the reference: each point's own onset of contact, which is uncertain, or one frame for
    all.

    The first frame with contact comes half a frame after the contact, on average, so the displacement up to it would be
    missing. At 40 frames/s, positions of onset are off by 8.7 um at the border of a press. The error is 4.8 um if the
    reference is the position at which the border passed the point (`tracker.onset`). Tracking forward and backward in
    time agree: at 40 frames/s both give the median divergence to 1 % and the energy to 6 %. They seed points in
    different frames, and as large a change comes from using as many points more or fewer.

    Attributes:
        attributes: of variables that count from the reference of displacement.
        border: of the contact in all frames, mm, without the vibration of the image.
        entered: (E,) indices of the points that were advected into the contact (`tracker.entry`); empty for a frame.
        by_onsets: True if points count from their own onsets.
        common_position: (N, 2) mm, of `tracker.recorded.common_frame`.
        steady_position: (F, N, 2) mm, of the points, without the vibration of the image.
        seeded: (N,) frame in which a point was seeded.
        begins: (N,) frame from which the displacement of a point counts: `onset`, or the frame for all.
        onset: (N,) first frame of the touch that lasts; -1 for none, and for points that were seeded inside the
            contact. By onsets it is also -1 for points that were lost then, as a later frame would be taken for the
            onset.
        reference: (N, 2) mm, position at the reference. By onsets, a point whose touches all ended has the position of
            its first touch. NaN for points that are never in contact.
        noise: (N,) mean of `Displacement.variance` over the frames in which it is known, mm^2.
        onset_variance: (N,) frame^2, of the time of onset; 0 for none, NaN if the reference is a frame.
        of_onset: (N, 2, 2) mm^2, covariance by the error of the time of onset, the same in all frames; 0 if the
            reference is a frame.
        independent: (N,) share of it that is known to be independent of neighbours.
    """

    name = "deformation"
    gives = (*DISPLACEMENT, *FIELDS)
    needs = ("views.topography",)
    restored = False
    after: ClassVar[tuple[type[Stage], ...]] = (ContactStage, TrackingStage, FrameCheckStage)
    settings = (
        *("kind", "fields.gauge_length_mm", "fields.reference", "fields.strain", "fields.rate_window_s"),
        *("tracking.template", "tracking.direction", "tracking.window_px", "recording.times", "recording.first_frame"),
        *("contact.gross_radius_px", "calibration.mm_per_px", "calibration.topography_to_contact"),
    )

    def begin(self) -> None:
        inputs = self.inputs
        self.mm_per_px = inputs.geometry.topography_mm_per_px  # scale of the topographic view
        self._settings, self._engine = inputs.scene.fields, inputs.engine
        self._gauge: dict[str, float | str | int] = {"gauge_length_mm": self._settings.gauge_length_mm}
        self._median, self._variance, self._bias = np.full((3, len(self.trial), 5), np.nan)
        status = self.results["frame_status"][:]
        then, self.attributes = resolve_reference(inputs.scene, inputs.times, status, self.warnings)
        self.by_onsets, self.reference_frame = then is None, then
        # The first points are known in the first frame that is tracked, in which they are seeded.
        usable, backward = np.flatnonzero(self.usable), self.trial.stage(TrackingStage).backward
        first, position = int(usable[-1 if backward else 0]), self.results["position"]
        skin = common_frame(position, self.results["status"], self.mm_per_px, first, backward)
        self.common_position, self.seeded = skin
        self._later = self.seeded != first
        # On a slide, skin in contact and beside it may vibrate as one; displacement counts from one frame there.
        self._shaken, pressed = np.zeros((len(self.trial), 2), complex), inputs.scene.kind in ("press", "single_view")
        if pressed:
            counted = "displacement and strain are those without this motion, positions those with it"
            self._shaken, vibrates = vibration(position, self.results["in_contact"], usable, self.mm_per_px, counted)
            self.warnings += vibrates
        self.steady_position = SteadyPositions(position, self._shaken) if self._shaken.any() else position
        border = FrameEllipse(*(self.results[f"ellipse_{part}"][:] for part in FrameEllipse._fields))
        self.border = self._onset_border = border._replace(center=steady(border.center, self._shaken))
        self._dilated = inputs.scene.fields.reference == "dilated_onset"
        if self._dilated:
            axes = border.semi_axes + inputs.scene.contact.gross_radius_px * inputs.mm_per_px
            self._onset_border = self.border._replace(semi_axes=axes)
        here = slice(int(usable[0]), int(usable[0]) + 1)
        covered, border_then = self.results["in_contact"][here][0], self._onset_border.select(here)
        self._unseen = UnseenTouches(self.steady_position[here][0], covered, border_then)
        points = position.shape[1]
        self._curvature_then = np.zeros(points, np.float32)
        if then is not None:
            # Positions of all points, and their variances, in the frame from which displacement counts.
            reference = self._skin(np.array([then]))
            self._fixed, self._fixed_noise = reference.position[0], reference.noise[0]
            self._curvature_then = reference.curvature[0] * np.float32(self.mm_per_px**2)
        gross = self.results["gross_contact_area"][:]
        self._landings = second_touches(gross) if self.by_onsets else np.zeros(0, int)
        self._find_onsets()
        moves_in = np.zeros(points, dtype=bool)
        if self.by_onsets:
            for frame in self._landings[:1] + self.first_frame:
                self.warnings.append(
                    f"the finger leaves the glass and touches it again in frame {frame}: from there on, displacement "
                    f"and strain of skin that touched before are unknown. Process each touch alone, by "
                    f"recording.first_frame and last_frame"
                )
            if pressed:
                self.warnings += check_beginning(gross, self.first_frame)
                self.warnings += plausibility.check_growth_time(gross)
            motion = self.onset, self.reference, self._settings.gauge_length_mm, self._onset_border
            moves_in = advected(self.steady_position, self.common_position, *motion)
            known = inputs.engine, self.onset, self.reference, moves_in, (here.start, len(self.trial) - 1)
            rim_mm = self.trial.stage(ContactStage).faint_rim_mm
            errors = onset_errors(*known, self._select_positions, self._onset_border, rim_mm)
            self.onset_variance, self.of_onset, self.independent = errors
        else:
            self.onset_variance, self.of_onset = np.full(points, np.nan), np.zeros((points, 2, 2))
            self.independent = self.of_onset[:, 0, 0]
            self._warn_of_unknown()
        self.entered = np.flatnonzero(moves_in)
        self.results.put("onset_frame", np.where(self.onset < 0, -1, self.onset + self.first_frame), point=points)
        # Skin that touches from the first frame on came into contact at an unknown time. Displacement counts from a
        # time between frames; whole frames, of the coverage alone, are off by more: measured on real prints.
        variance = np.where(self.onset_variance > 0, 0.12 + 2.1 * self.onset_variance, np.nan)
        self.results.put("onset_frame_std", np.sqrt(variance))
        entry = np.where(moves_in, ENTRY.index("entered"), np.isfinite(self.reference).all(1))
        self.results.put("entry", np.where(self._inside, ENTRY.index("seeded_inside"), entry).astype(np.uint8))
        self.results.put("reference_position", self.reference, self.attributes)
        for name in ("displacement", "displacement_std"):
            self.results.create(name, self.attributes)
        self._touch = Touches(points)
        self._begin_fields()

    def _begin_fields(self) -> None:
        """Create the result variables of the fields, and prepare their computation."""
        self._gauge |= self.attributes
        self._stated = ["divergence", "curl", "divergence_std", "curl_std", *({"shear"} & self.trial.requested)]
        for name in self._stated:
            self.results.create(name, self._gauge)
        if "rigid_residual" in self.trial.requested:
            self.results.create("rigid_residual")
            self.results.create("rigid_residual_std")
        widest = 2 * np.fmax.reduce(self.border.semi_axes[:, 1])
        self.warnings += plausibility.check_gauge(self._settings.gauge_length_mm, widest)
        # Neighbours by where points were seeded: positions of entry lie on a line.
        positions = self.common_position if self.by_onsets else self.reference
        self._deformation = Deformation(self._engine, positions)
        positions_px = self.inputs.geometry.on_topography(positions)
        window_px = self.inputs.scene.tracking.window_px
        errors = OverlapErrors(self.begins, positions_px, self.noise, self.of_onset, self.by_onsets, window_px)
        self._gain = errors.variance_gain(self._settings.gauge_length_mm / self.mm_per_px)
        self._entry, self._late = EntryGradients(self._engine, self.common_position), np.zeros((2, len(self.onset)))
        for onset in set(self.onset[self.entered].tolist()):
            frames = np.array([onset]), np.array([max(onset - EntryGradients.BEFORE, 0)])
            self._entry.learn(self.entered[self.onset[self.entered] == onset], *map(self._tracked, frames))
        known = self.entered[self.onset[self.entered] >= EntryGradients.BEFORE]  # change before the entry
        late = np.sqrt(self.onset_variance[known])[:, None, None] * self._entry.change[known]
        self._late[:, known] = variance_of_late(late)

    def step(self, batch: Batch) -> Displacement:
        """Compute the results of a batch of frames, and return the displacement without touches that do not last."""
        frames = batch.indices
        now = self._deformation.step(self._skin(frames), self)
        self.results["displacement"][frames] = now.since.displacement
        self.results["displacement_std"][frames] = np.sqrt(now.square)  # root mean square error of a component
        self.series["global_displacement_vector"][frames] = now.vector
        self.series["global_displacement_vector_std"][frames] = now.vector_std
        if "printed_global_displacement" in self.series:
            # Component by component (the lab's script takes the x median twice).
            median = nanmedian(now.since.displacement)
            self.series["printed_global_displacement"][frames] = np.linalg.norm(median, axis=1)
        for name in self._stated:
            self.results[name][frames] = getattr(now.fields, name)
        reference, moved = (self.inputs.tensor(values) for values in (self.reference[None], now.lasting.displacement))
        residual = rigid_residual(reference, moved).cpu().numpy()
        across, down = residual[..., 0], residual[..., 1]  # norms over an axis of two take ten times as long
        length = np.sqrt(across * across + down * down)
        # Three points, moved rigidly, leave hardly a residual.
        enough = (np.isfinite(length).sum(1) > 3) & (now.fields.known_share >= LEAST_SHARE)
        median = np.where(enough, nanmedian(length), np.nan)
        of_points, of_median = residual_deviations(length, median, now.square, now.since.variance, now.since.curvature)
        for name, values in (("rigid_residual", residual), ("rigid_residual_std", of_points)):
            if name in self.results:
                self.results[name][frames] = values
        self.series["rigid_residual_median"][frames] = median
        self.series["rigid_residual_median_std"][frames] = of_median
        self.series["field_coverage"][frames] = now.fields.known_share
        self._median[frames], self._variance[frames], self._bias[frames] = now.fields.median, now.variance, now.bias
        return now.lasting

    def since(self, skin: SkinFrames) -> Displacement:
        """Return the displacement in the next frames, with what the whole recording tells (`Onsets`)."""
        frames = skin.numbers
        moved, noise = self._since_touch(self._touch, skin)
        moved[:, self._inside] = noise[:, self._inside] = np.nan
        unseen: Array | float = 0.0
        if self.by_onsets:
            unseen = self._unseen.variance(skin.position, moved, self._onset_border.select(frames))
        # A touch in passing counts from itself.
        passing = (self.onset < 0) | (frames[:, None] < self.onset) if self.by_onsets else None
        curvature = abs(skin.curvature * np.float32(self.mm_per_px**2) - self._curvature_then)
        entered = None
        if len(self.entered):
            entered = self._entry.since_entry(self.entered, *self._tracked(frames))
            entered.gradient[frames[:, None] < self.onset] = np.nan
        more = self.of_onset, self._gain, entered, self._late, unseen, passing
        return Displacement(self.reference, moved, noise, curvature, *more)

    def finish(self) -> None:
        vector, vector_std = (self.series[f"global_displacement_vector{of}"] for of in ("", "_std"))
        length, length_std = displacement_length(vector, vector_std)
        self.series |= {"global_displacement": length, "global_displacement_std": length_std}
        for name in ("global_displacement_vector", "global_displacement", "printed_global_displacement"):
            self.about[name] = self.attributes
        # Interpolated between the frames in which it was evaluated, as skin and contact change slowly.
        changed, frames = (np.diff(self._bias, axis=0, prepend=np.nan) != 0).any(1), np.arange(len(self.trial))
        evaluated = np.flatnonzero(changed & np.isfinite(self._bias).all(1))
        if len(evaluated):
            self._bias = np.stack([np.interp(frames, evaluated, part) for part in self._bias[evaluated].T], axis=1)
        median_std = np.sqrt(self._variance + self._bias)
        times, window = self.inputs.times, self._settings.rate_window_s
        rates, rates_std = rate(self._median, times, window), rate(median_std, times, window, of_std=True)
        if np.isnan(rates).all() > np.isnan(self._median).all():
            self.warnings.append(f"fields.rate_window_s = {window:g} lasts longer than the medians are known: no rates")
        for columns, names in (
            (0, ("median_divergence", "median_divergence_std", "median_divergence_rate", "median_divergence_rate_std")),
            (1, ("median_curl", "median_curl_std")),
            (slice(2, None), ("median_strain", "median_strain_std", "median_strain_rate", "median_strain_rate_std")),
        ):
            self.about[names[0]] = self._gauge
            for name, values in zip(names, (self._median, median_std, rates, rates_std), strict=False):
                self.series[name] = values[:, columns]
        self.about["median_strain"] = self._gauge | {"measure": self._settings.strain}
        of_frames = self._median[:, 0], self.series["field_coverage"], self.results["gross_contact_area"][:]
        self.warnings.extend(plausibility.check_fields(*of_frames, self._settings.gauge_length_mm, self.first_frame))

    def tracked_variance(self, indices: Numbers, name: str) -> Array:
        """Return the variance (n, N) mm^2 of each coordinate of the tracked positions of N points in n frames; `name`
        is the result variable of the standard deviation.
        """
        return (self.results[name][indices] * np.float32(self.mm_per_px)) ** 2

    def _tracked(self, frames: Numbers) -> tuple[Points, Array]:
        """Return the positions (n, N, 2) mm in n frames without the vibration, and their variances (n, N) mm^2."""
        return self.steady_position[frames], self.tracked_variance(frames, "position_std_px")

    def _skin(self, frames: Numbers) -> SkinFrames:
        """Return the tracked points in n frames."""
        whole, noise = (self.results[f"position_{of}_px"][frames] ** 2 for of in ("std", "noise"))
        position, covered = self.steady_position[frames], self.results["in_contact"][frames]
        return SkinFrames(frames, covered, position, noise, np.maximum(whole - noise, 0), self.border.select(frames))

    def _find_onsets(self) -> None:
        touch = Touches(self.results["position"].shape[1])
        count, total = np.zeros((2, touch.points))
        for indices in runs_of_frames(len(self.trial)):
            _, variance = self._since_touch(touch, self._skin(indices))
            finite = np.isfinite(variance)
            count += finite.sum(0)
            total += np.where(finite, variance, 0).sum(0, dtype=np.float64)
        self.noise = total / np.maximum(count, 1)
        # The onset is unknown for a point that is already in contact when it is seeded later.
        self._inside = self._later & (touch.first == self.seeded)
        # A touch in the last frame counts as lasting, as later frames are unknown.
        stays, touched = (touch.length > 0) & ~self._inside, (touch.first >= 0) & ~self._inside
        self.reference = np.where(stays[:, None], touch.position, touch.first_position)
        self.reference[~touched] = np.nan
        known_then = stays & np.isfinite(self.reference).all(-1)
        self.onset = self.begins = np.where(known_then, touch.start, -1).astype(np.int32)
        if not self.by_onsets:
            self.onset = np.where(stays, touch.start, -1).astype(np.int32)
            self.begins = np.full_like(self.onset, self.reference_frame)
            self.reference = np.where(touched[:, None], self._fixed, np.nan)

    def _warn_of_unknown(self) -> None:
        touching = self.onset >= 0
        unknown = touching & ~np.isfinite(self.reference).all(1)
        if unknown.any():
            self.warnings.append(
                f"{int(unknown.sum())} of the {int(touching.sum())} points that come into contact are not known in "
                f"fields.reference, frame {self.attributes['reference_frame']}: their displacement is NaN"
            )

    def _since_touch(self, touch: Touches, skin: SkinFrames) -> tuple[Points, Array]:
        """Return the displacements (n, N, 2) mm of N points since each came into contact, and their variances (n, N)
        mm^2 by image noise, in n frames; `touch` holds the onset of each point and is updated.
        """
        moved, noise = np.full_like(skin.position, np.nan), np.full_like(skin.noise, np.nan)
        usable = np.flatnonzero(self.usable[skin.numbers])  # an unusable frame does not end a touch
        if not len(usable):
            return moved, noise
        frames, covered, position, variance = (values[usable] for values in skin[:4])
        border = self._onset_border.select(frames)
        if self._dilated:
            covered = covered | (border.inside(position) > 0)
        touching = touch.add_frames(frames, covered, position, variance, border)
        if not self.by_onsets:
            reference = np.where(touching.touching[..., None], self._fixed, np.nan)
            exact = np.broadcast_to(self._fixed_noise, variance.shape)
            begins = np.broadcast_to((frames == self.reference_frame)[:, None], variance.shape)
            touching = Touching(reference, np.ones_like(variance), exact, exact, touching.touching, begins)
        moved[usable] = position - touching.position
        if len(self._landings):  # skin moves in the air between two touches
            later, since = (np.searchsorted(self._landings, at, "right") for at in (frames[:, None], touch.start))
            moved[usable] = np.where((later > since)[..., None], np.nan, moved[usable])
        variance = noise_variance(variance, touching, adds_up=self.inputs.scene.tracking.template == "previous")
        noise[usable] = variance * np.float32(self.mm_per_px**2)
        noise[np.isnan(moved[..., 0] + moved[..., 1])] = np.nan
        return moved, noise

    def _select_positions(self, frames: Numbers) -> tuple[Points, Points]:
        """Return the positions (..., N, 2) mm of N tracked points, each in the frame that `frames` (..., N) gives for
        it, and their deviations (..., N) by image noise, mm.
        """
        noise = self.mm_per_px * values_at(self.results["position_noise_px"], frames)
        return values_at(self.steady_position, frames), noise
