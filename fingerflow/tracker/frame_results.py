"""Results of a frame of a stream: contact areas, point positions, slip, and strain fields since contact onset."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.engines.contact_view import covers
from fingerflow.engines.engine import Engine, FrameContact, TrackedPoints
from fingerflow.recordings.lens import Geometry
from fingerflow.schema.variables import sparse_border_mm
from fingerflow.tracker.deformation import Deformation, Displacement, SkinFrames
from fingerflow.tracker.deviations.curvature import Curvature
from fingerflow.tracker.deviations.image_noise import noise_variance
from fingerflow.tracker.deviations.medians import strain_deviations
from fingerflow.tracker.deviations.overlap import OverlapErrors
from fingerflow.tracker.displacement_medians import displacement_length
from fingerflow.tracker.entry import Entries, variance_of_late
from fingerflow.tracker.onset import Touches, interpolate_displacement
from fingerflow.tracker.sizes_on_glass import SizesOnGlass
from fingerflow.tracker.slip_flag import SlipFlag

Array = NDArray[Any]

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
    *("slip_residual", "slip_flag"),
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
        self._slip = SlipFlag()
        self._seeding: Seeding | None = None
        self.entries = Entries(engine, np.zeros((0, 2)))
        self._frames = 0
        self._gross = self._faint_mm = 0.0  # of the largest contact so far
        self._touches = Touches(0)

    @property
    def slipping(self) -> bool:
        """Return the slip flag after the last usable frame: whether skin in contact slips."""
        return self._slip.slipping

    def compute(self, seeding: Seeding, contact: FrameContact, points: TrackedPoints) -> dict[str, Any]:
        """Compute the results of the next frame, by the names in `RESULTS`, from its contact, its tracked points
        `points` and the seeding to which these points belong.
        """
        covered = covers(contact.density_margin, points.estimate, self._to_contact, self._engine.cell_px)
        if seeding is not self._seeding:
            self._begin(seeding, covered[0])
        self._frames += 1
        variance = points.variance  # by image noise
        curvature, sizes = self._curvature.update(points.points), self.on_glass.sizes(contact)
        if sizes.gross[0] > self._gross:
            self._gross, self._faint_mm = float(sizes.gross[0]), sparse_border_mm(sizes.real, sizes.gross)
        residual = self._slip.update(points.points[0], np.sqrt(variance[0]), covered[0])
        position = self._geometry.on_glass(points.points)
        skin = SkinFrames(np.array([self._frames]), covered, position, variance, curvature, sizes.ellipse)
        now = self._deformation.step(skin, self)
        fields, median = now.fields, now.fields.median[0]
        median_std = np.sqrt(now.variance[0] + self._deformation.latest)
        length, length_std = displacement_length(now.vector, now.vector_std)
        assert fields.divergence_std is not None
        assert fields.curl_std is not None
        return {
            **{"real_contact_area": sizes.real[0], "gross_contact_area": sizes.gross[0]},
            **{"ellipse_center": sizes.ellipse.center[0], "ellipse_semi_axes": sizes.ellipse.semi_axes[0]},
            **{"ellipse_angle": sizes.ellipse.angle[0], "illumination_gain": contact.illumination_gain[0]},
            **{"position_px": points.points[0], "forward_backward_error": points.error[0]},
            **{"position_std_px": np.sqrt(variance + curvature)[0], "status": points.status[0]},
            "in_contact": covered[0],
            **{"point_strain": fields.strain[0], "entered": self.entries.entered.copy()},
            "point_strain_std": strain_deviations(fields.divergence_std[0], fields.curl_std[0]),
            **{"divergence": fields.divergence[0], "divergence_std": fields.divergence_std[0]},
            **{"curl": fields.curl[0], "curl_std": fields.curl_std[0]},
            **{"median_divergence": median[0], "median_divergence_std": median_std[0]},
            **{"median_curl": median[1], "median_curl_std": median_std[1]},
            **{"median_strain": median[2:], "median_strain_std": median_std[2:]},
            **{"global_displacement_vector": now.vector[0], "global_displacement_vector_std": now.vector_std[0]},
            **{"global_displacement": length[0], "global_displacement_std": length_std[0]},
            "slip_residual": residual * self._per_px,
            "slip_flag": self._slip.slipping,
        }

    def _begin(self, seeding: Seeding, covered: Array) -> None:
        self._seeding, count = seeding, len(seeding.points)
        positions, gauge_mm = self._geometry.on_glass(seeding.points), self._engine.settings.gauge_length_mm
        # (N,) mm^2, variance of displacements taken over from previous points; NaN where there are none, so that the
        # displacement of skin that was in contact when it was seeded is not known.
        self._inherited, touches = np.zeros(count), Touches(count)
        if seeding.before is not None:
            self._slip.follow_others(seeding.before, seeding.points)
        if self._frames:  # before the first frame, skin that is in contact has no earlier displacement
            rows, before = covered.nonzero()[0], np.zeros((0, 2)) if seeding.before is None else seeding.before
            moved = self._geometry.on_glass(before) - self._touches.position[: len(before)]
            inherited, self._inherited[rows] = interpolate_displacement(before, moved, seeding.points[rows], 1)
            touches.replace(rows, positions[rows] - inherited)
        self._touches = touches
        self.entries, self._curvature = Entries(self._engine, positions), Curvature(self._engine, seeding.points)
        self._deformation = Deformation(self._engine, positions)
        # Noise counts alike for all points, and their onsets are not known yet.
        alike = np.zeros(count, int), seeding.points, np.ones(count), np.zeros((count, 2, 2))
        errors = OverlapErrors(*alike, by_onsets=True, window_px=self._engine.settings.window_px)
        self._gain = errors.variance_gain(gauge_mm / self._per_px)

    def since(self, skin: SkinFrames) -> Displacement:
        """Return the displacement in the next frame since the onset of contact of each point (`Onsets`)."""
        position, px2 = skin.position, np.float32(self._per_px**2)
        left = np.isnan(self._inherited) & (skin.covered[0] == 0)
        if np.logical_or.reduce(left):
            self._inherited[left] = 0
            self._touches.replace(left.nonzero()[0], np.full((int(left.sum()), 2), np.nan))
        touch = self._touches.add_frames(skin.numbers, skin.covered, position, skin.noise, skin.border)
        variance = (skin.noise[0] + skin.curvature[0]) * px2
        touched = touch.begins[0], touch.touching[0], touch.position[0]
        entered = self.entries.update(position[0], variance, skin.covered[0], *touched, skin.border)
        self.entries.learn_errors(self._faint_mm)
        noise = noise_variance(skin.noise, touch) * px2 + self._inherited.astype(np.float32)
        moved = position - touch.position
        moved[0, np.isnan(self._inherited)] = np.nan
        entries, reference, curvature = self.entries, touch.position[0], skin.curvature * px2
        late = variance_of_late(entries.late)
        return Displacement(reference, moved, noise, curvature, entries.of_onset, self._gain, entered, late)
