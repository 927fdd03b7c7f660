"""Results of a frame of a stream: contact areas, point positions, slip, and strain fields since contact onset."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.engines.contact_view import covers
from fingerflow.engines.engine import Engine, FrameContact, FrameEllipse, TrackedPoints
from fingerflow.recordings.lens import Geometry
from fingerflow.tracker.deformation import EVERY, Deformation, Displacement
from fingerflow.tracker.deviations.curvature import Curvature
from fingerflow.tracker.deviations.image_noise import noise_variance
from fingerflow.tracker.deviations.overlap import OverlapErrors
from fingerflow.tracker.displacement_medians import displacement_length, displacement_medians
from fingerflow.tracker.entry import Entries
from fingerflow.tracker.onset import Touches, interpolate_displacement
from fingerflow.tracker.sizes_on_glass import SizesOnGlass
from fingerflow.tracker.slip_flag import SlipFlag

Array = NDArray[Any]

#: Names of the results of a frame, which are variables of the data set.
RESULTS = (
    *(
        "real_contact_area",
        "gross_contact_area",
        "ellipse_center",
        "ellipse_semi_axes",
        "ellipse_angle",
        "illumination_gain",
    ),
    *("position_px", "forward_backward_error", "position_std_px", "status", "in_contact"),
    *("divergence", "divergence_std", "curl", "curl_std", "point_strain", "entered"),
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
    """

    def __init__(self, engine: Engine, geometry: Geometry) -> None:
        self._engine, self._geometry = engine, geometry
        self._to_contact = geometry.topography_to_contact.astype(np.float32)
        self._on_glass, self._per_px = SizesOnGlass(geometry, engine.cell_px), geometry.topography_mm_per_px
        self._slip = SlipFlag()
        self._seeding: Seeding | None = None
        self._frames = 0
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
        curvature, sizes = self._curvature.update(points.points), self._on_glass.sizes(contact)
        ellipse = sizes.ellipse
        residual = self._slip.update(points.points[0], np.sqrt(variance[0]), covered[0])
        return {
            "real_contact_area": sizes.real[0],
            "gross_contact_area": sizes.gross[0],
            "ellipse_center": ellipse.center[0],
            "ellipse_semi_axes": ellipse.semi_axes[0],
            "ellipse_angle": ellipse.angle[0],
            "illumination_gain": contact.illumination_gain[0],
            "position_px": points.points[0],
            "forward_backward_error": points.error[0],
            "position_std_px": np.sqrt(variance + curvature)[0],
            "status": points.status[0],
            "in_contact": covered[0],
            **self._since_onset(points.points, variance, curvature, covered, ellipse),
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
        self._entries, self._curvature = Entries(self._engine, positions), Curvature(self._engine, seeding.points)
        self._deformation = Deformation(self._engine, positions)
        # Noise counts alike for all points, and their onsets are not known yet.
        alike = np.zeros(count, int), seeding.points, np.ones(count), np.zeros((count, 2, 2))
        errors = OverlapErrors(*alike, by_onsets=True, window_px=self._engine.settings.window_px)
        self._gain = errors.variance_gain(gauge_mm / self._per_px)

    def _since_onset(
        self, points: Array, noise: Array, curvature: Array, covered: Array, ellipse: FrameEllipse
    ) -> dict[str, Any]:
        """Compute divergence, curl and strain at each point from the displacement of the skin since the point's onset
        of contact, and their medians and that of the displacement over the contact ellipse; return them by result name.

        `noise` and `curvature` (1, N) px^2 are the variances of the positions `points` (1, N, 2) px by image noise and
        by curved displacement.
        """
        position, px2 = self._geometry.on_glass(points), np.float32(self._per_px**2)
        variance, frame = noise + curvature, np.array([self._frames])
        left = np.isnan(self._inherited) & (covered[0] == 0)
        if np.logical_or.reduce(left):
            self._inherited[left] = 0
            self._touches.replace(left.nonzero()[0], np.full((int(left.sum()), 2), np.nan))
        touch = self._touches.add_frames(frame, covered, position, noise, ellipse)
        entered = self._entries.update(
            position[0], variance[0] * px2, touch.begins[0], touch.touching[0], touch.position[0], ellipse
        )
        if self._frames % EVERY == 0:
            self._entries.learn_errors()
        of_displacement = (noise_variance(noise, touch) + curvature) * px2 + self._inherited.astype(np.float32)
        reference, moved = touch.position[0], position - touch.position
        moved[0, np.isnan(self._inherited)] = np.nan
        since = Displacement(reference, moved, of_displacement, self._entries.of_onset, self._gain, entered)
        fields, ranks = self._deformation.add(frame, since, ellipse)
        assert fields.divergence_std is not None
        assert fields.curl_std is not None
        assert fields.median_std is not None
        onset = self._entries.of_onset
        square = of_displacement + (onset[:, 0, 0] + onset[:, 1, 1]) / 2
        reach = self._engine.settings.gauge_length_mm / 2
        vector, vector_std = displacement_medians(position, moved, square, ellipse, reach)
        length, length_std = displacement_length(vector, vector_std)
        median, median_std = fields.median[0], np.sqrt(fields.median_std[0] ** 2 + ranks[0] + self._deformation.latest)
        return {
            **{"point_strain": fields.strain[0], "entered": self._entries.entered.copy()},
            **{"divergence": fields.divergence[0], "divergence_std": fields.divergence_std[0]},
            **{"curl": fields.curl[0], "curl_std": fields.curl_std[0]},
            **{"median_divergence": median[0], "median_divergence_std": median_std[0]},
            **{"median_curl": median[1], "median_curl_std": median_std[1]},
            **{"median_strain": median[2:], "median_strain_std": median_std[2:]},
            **{"global_displacement_vector": vector[0], "global_displacement_vector_std": vector_std[0]},
            **{"global_displacement": length[0], "global_displacement_std": length_std[0]},
        }
