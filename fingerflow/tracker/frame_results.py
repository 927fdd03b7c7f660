"""Results of a frame of a stream: contact areas, point positions, slip, and strain fields since contact onset."""

from typing import NamedTuple

import numpy as np

from fingerflow.engines.contact_view import covers
from fingerflow.engines.engine import Engine, EnteredPoints, FrameContact, TrackedPoints
from fingerflow.kernels.array_types import Array
from fingerflow.kernels.field_limits import LEAST_SHARE
from fingerflow.recordings.lens import Geometry
from fingerflow.schema.variables import sparse_border_mm
from fingerflow.tracker.deformation import Deformation, Displacement, SkinFrames
from fingerflow.tracker.deviations.curvature import Curvature
from fingerflow.tracker.deviations.image_noise import noise_variance
from fingerflow.tracker.deviations.medians import strain_deviations
from fingerflow.tracker.deviations.overlap import OverlapErrors
from fingerflow.tracker.displacement_medians import displacement_length
from fingerflow.tracker.entry import Entries, join_entered, variance_of_late
from fingerflow.tracker.onset import LASTING, Touches, interpolate_displacement
from fingerflow.tracker.points import select_frames
from fingerflow.tracker.sizes_on_glass import Sizes, SizesOnGlass
from fingerflow.tracker.slip_flag import SlipFlag

#: Names of the results of a frame, which are variables of the data set.
RESULTS = (
    *("real_contact_area", "gross_contact_area", "ellipse_center", "ellipse_semi_axes"),
    *("ellipse_angle", "illumination_gain"),
    *("position_px", "forward_backward_error", "position_std_px", "status", "in_contact"),
    *("divergence", "divergence_std", "curl", "curl_std", "point_strain", "point_strain_std", "entered"),
    *("median_divergence", "median_divergence_std", "median_curl", "median_curl_std"),
    *("median_strain", "median_strain_std"),
    *("global_displacement_vector", "global_displacement_vector_std"),
    *("global_displacement", "global_displacement_std"),
    "slip_flag",
)


class Seeding(NamedTuple):
    """Seeded points with which tracking starts: positions (N, 2) px in a frame, padded with NaN.

    `before` (M, 2) px are the positions of the previous points in the frame of the seeding; None for the first seeding.
    """

    points: Array
    before: Array | None


class FrameResults:
    """Computation of the results of a stream (contact areas, slip, strain: `RESULTS`), frame by frame; after a seeding
    of new points, quantities that count from the onset of contact start again.

    Tracking does not depend on this state: results may be computed in a thread of their own.

    Args:
        engine: that computes.
        geometry: of the views.

    Attributes:
        on_glass: conversion of contact sizes to mm.
        entries: entries of the current points into the contact.
    """

    def __init__(self, engine: Engine, geometry: Geometry) -> None:
        self._engine, self._geometry = engine, geometry
        self._to_contact = geometry.topography_to_contact.astype(np.float32)
        self.on_glass, self._per_px = SizesOnGlass(geometry, engine.cell_px), geometry.topography_mm_per_px
        self.slip = SlipFlag()
        self._seeding: Seeding | None = None
        self.entries = Entries(engine, np.zeros((0, 2)))
        self._frames = 0
        self._gross = self._faint_mm = 0.0  # of the largest contact so far
        self._sizes: Sizes  # of the contact in the present frames
        self._entered = np.zeros((0, 0), dtype=bool)  # which points have entered, in each of them
        self._lifted, self._touches, self._inherited = False, Touches(0), np.zeros(0)

    def compute(self, seeding: Seeding, contact: FrameContact, points: TrackedPoints, pull: Array) -> dict[str, Array]:
        """Compute the results of the next n frames, as arrays (n, ...) by the names in `RESULTS`, from their contact,
        their tracked points `points`, `pull` (n, N) of these (`Points.pull`), and the seeding to which they belong.

        They do not depend on how many frames are computed at once, but for rounding of float32.
        """
        covered = covers(contact.density_margin, points.estimate, self._to_contact, self._engine.cell_px)
        touched = contact.gross_area_px != 0
        if seeding is not self._seeding:
            self._begin(seeding, covered[0])
        parts, first = list[dict[str, Array]](), 0
        while first < len(covered):
            frames = slice(first, first + self._batch(covered[first:], touched[first:]))
            here = select_frames(contact, frames), select_frames(points, frames)
            parts.append(self._at_once(*here, covered[frames], pull[frames]))
            first = frames.stop
        if len(parts) == 1:
            return parts[0]
        return {name: np.concatenate([part[name] for part in parts]) for name in RESULTS}

    def _at_once(self, contact: FrameContact, points: TrackedPoints, covered: Array, pull: Array) -> dict[str, Array]:
        """Compute the results of n frames in one call; `covered` (n, N) is True for points inside the contact."""
        numbers = self._frames + 1 + np.arange(len(covered))
        variance = points.variance  # by image noise
        curvature, sizes = self._curvature.update(points.points) + pull, self.on_glass.sizes(contact)
        noise_px, self._sizes = np.sqrt(variance), sizes
        slipping = np.empty(len(covered), dtype=bool)
        for k in range(len(covered)):
            self.slip.update(points.points[k], noise_px[k], covered[k])
            slipping[k] = self.slip.slipping
        skin = SkinFrames(numbers, covered, self._geometry.on_glass(points.points), variance, curvature, sizes.ellipse)
        now = self._deformation.step(skin, self)
        fields, median, median_std = now.fields, now.fields.median, np.sqrt(now.variance + now.bias)
        # Skin that was in contact when it was seeded lies in the middle, where fields are largest.
        hollow = np.add.reduce(covered & np.isnan(self._inherited), 1) > (1 - LEAST_SHARE) * np.add.reduce(covered, 1)
        median[hollow] = median_std[hollow] = np.nan
        length, length_std = displacement_length(now.vector, now.vector_std)
        assert fields.divergence_std is not None
        assert fields.curl_std is not None
        return {
            **sizes.by_name(),
            "illumination_gain": contact.illumination_gain,
            **{"position_px": points.points, "forward_backward_error": points.error},
            **{"position_std_px": np.sqrt(variance + curvature), "status": points.status, "in_contact": covered},
            **{"point_strain": fields.strain, "entered": self._entered},
            "point_strain_std": strain_deviations(fields.divergence_std, fields.curl_std),
            **{"divergence": fields.divergence, "divergence_std": fields.divergence_std},
            **{"curl": fields.curl, "curl_std": fields.curl_std},
            **{"median_divergence": median[:, 0], "median_divergence_std": median_std[:, 0]},
            **{"median_curl": median[:, 1], "median_curl_std": median_std[:, 1]},
            **{"median_strain": median[:, 2:], "median_strain_std": median_std[:, 2:]},
            **{"global_displacement_vector": now.vector, "global_displacement_vector_std": now.vector_std},
            **{"global_displacement": length, "global_displacement_std": length_std},
            "slip_flag": slipping,
        }

    def _batch(self, covered: Array, touched: Array) -> int:
        """Return how many of the next frames can be computed at once, given which points the contact covers in each,
        `covered` (n, N), and whether there is a contact, `touched` (n,): those before the finger lands, or a point
        touches again elsewhere, and one while it is unknown from where points count, or how medians err by the gauge
        length; and one for graphs of fixed shapes.
        """
        if self._engine.fixed or np.isnan(self._deformation.latest[0]) or np.isnan(self._inherited).any():
            return 1
        landing = (touched[1:] > touched[:-1]).nonzero()[0]
        covered = covered[: landing[0] + 1] if len(landing) else covered
        before = np.logical_or.accumulate(covered[:-2])
        again = before & (covered[1:-1] < covered[2:]) & (self._touches.length < LASTING)
        frames = np.logical_or.reduce(again, 1)
        return 2 + int(frames.argmax()) if frames.any() else len(covered)

    def _begin(self, seeding: Seeding, covered: Array) -> None:
        self._seeding, count = seeding, len(seeding.points)
        positions, gauge_mm = self._geometry.on_glass(seeding.points), self._engine.settings.gauge_length_mm
        # Where some displacements are not known, the known ones may be those of the rim alone: none is taken over.
        before = np.zeros((0, 2)) if seeding.before is None or np.isnan(self._inherited).any() else seeding.before
        # (N,) mm^2, variance of displacements taken over from previous points, over all seedings; NaN where there are
        # none, so that the displacement of skin that was in contact when it was seeded is not known.
        earlier, self._inherited, touches = self._inherited[: len(before)], np.zeros(count), Touches(count)
        if seeding.before is not None:
            self.slip.follow_others(seeding.before, seeding.points)
        if self._frames:  # before the first frame, skin that is in contact has no earlier displacement
            rows, moved = covered.nonzero()[0], self._geometry.on_glass(before) - self._touches.position[: len(before)]
            new = seeding.points[rows], 1, gauge_mm / self._per_px
            inherited, self._inherited[rows] = interpolate_displacement(before, moved, *new)
            # Neighbours share the errors of what they have inherited themselves: these do not show in their scatter.
            shared, _ = interpolate_displacement(before, 0 * moved + earlier[:, None], *new)
            self._inherited[rows] += shared[:, 0]
            touches.replace(rows, positions[rows] - inherited)
        self._touches, self._deformation = touches, Deformation(self._engine, positions)
        self.entries, self._curvature = Entries(self._engine, positions), Curvature(self._engine, seeding.points)
        # Noise counts alike for all points, and their onsets are not known yet.
        alike = np.zeros(count, int), seeding.points, np.ones(count), np.zeros((count, 2, 2))
        errors = OverlapErrors(*alike, by_onsets=True, window_px=self._engine.settings.window_px)
        self._gain = errors.variance_gain(gauge_mm / self._per_px)

    def since(self, skin: SkinFrames) -> Displacement:
        """Return the displacement in the next n frames since the onset of contact of each point (`Onsets`)."""
        position, px2, entries, sizes = skin.position, np.float32(self._per_px**2), self.entries, self._sizes
        self._frames += len(position)
        # Skin moves in the air: all touches begin anew as the finger lands.
        left = (np.isnan(self._inherited) & (skin.covered[0] == 0)) | self._lifted
        self._lifted = sizes.gross[-1] == 0
        if np.logical_or.reduce(left):
            self._inherited[left] = 0
            self._touches.replace(left.nonzero()[0], np.full((1, 2), np.nan))
        touch = self._touches.add_frames(skin.numbers, skin.covered, position, skin.noise, skin.border)
        variance = (skin.noise + skin.curvature) * px2
        self._entered = np.empty(skin.covered.shape, dtype=bool)
        onset, late = np.empty((*variance.shape, 2, 2)), np.empty((len(variance), 2, variance.shape[1]))
        entered: list[EnteredPoints | None] = []
        for k in range(len(position)):
            if sizes.gross[k] > self._gross:
                self._gross = float(sizes.gross[k])
                self._faint_mm = sparse_border_mm(sizes.real[k : k + 1], sizes.gross[k : k + 1])
            touched = touch.begins[k], touch.touching[k], touch.position[k]
            border = skin.border.select(slice(k, k + 1))
            entered.append(entries.update(position[k], variance[k], skin.covered[k], *touched, border))
            entries.learn_errors(self._faint_mm)
            self._entered[k], onset[k], late[k] = entries.entered, entries.of_onset, variance_of_late(entries.late)
        noise = noise_variance(skin.noise, touch) * px2 + self._inherited.astype(np.float32)
        moved = position - touch.position
        moved[:, np.isnan(self._inherited)] = np.nan
        # No point touches twice in these frames (`_batch`).
        reference, curvature = np.fmax.reduce(touch.position), skin.curvature * px2
        return Displacement(reference, moved, noise, curvature, onset, self._gain, join_entered(entered), late)
