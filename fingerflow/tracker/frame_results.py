"""Results of a frame of a stream: contact areas, point positions, slip, and strain fields since contact onset."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fingerflow.engines.contact_view import covers
from fingerflow.engines.engine import Engine, EnteredPoints, FrameContact, FrameEllipse, FrameFields, TrackedPoints
from fingerflow.tracker.contact_border import BORDER_MM, Border
from fingerflow.tracker.curvature import curvature_variance
from fingerflow.tracker.entry import Entries
from fingerflow.tracker.median_smoothing import smoothing_variance
from fingerflow.tracker.onset import Touches, Touching
from fingerflow.tracker.overlap_gain import overlap_gain
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
    *("divergence", "curl", "point_strain", "median_divergence", "median_divergence_std", "entered"),
    *("slip_residual", "slip_flag"),
)
_EVERY = 8  # frames between two evaluations of the median's variance due to gauge length and border
#: Largest share of the points in contact whose onset is unknown, as they were seeded again on touching skin; with more,
#: no deviation is stated.
_WITHOUT_ONSET = 0.15


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
        topography_to_contact: (2, 3), maps px of the topography view to px of the contact view.
        mm_per_px: of the contact view.
    """

    def __init__(self, engine: Engine, topography_to_contact: Array, mm_per_px: float) -> None:
        self._engine, self._size = engine, mm_per_px
        matrix = topography_to_contact.astype(np.float64)
        self._to_contact = matrix.astype(np.float32)
        self._to_glass = (matrix * mm_per_px).tolist()  # maps px of the topography view to mm
        self._per_px = mm_per_px * math.sqrt(abs(np.linalg.det(matrix[:, :2])))
        self._slip = SlipFlag()
        self._seeding: Seeding | None = None
        self._frames = 0

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
        size = self._size
        noise = np.sqrt(points.variance)
        curvature = curvature_variance(self._engine, seeding.points, points.points)
        center, semi_axes = (lengths.astype(np.float64) * size for lengths in (contact.center, contact.semi_axes))
        ellipse = FrameEllipse(center, semi_axes, contact.angle.astype(np.float64))
        residual = self._slip.update(points.points[0], noise[0], covered[0])
        return {
            "real_contact_area": float(contact.real_area_px[0]) * size**2,
            "gross_contact_area": float(contact.gross_area_px[0]) * size**2,
            "ellipse_center": ellipse.center[0],
            "ellipse_semi_axes": ellipse.semi_axes[0],
            "ellipse_angle": contact.angle[0],
            "illumination_gain": contact.illumination_gain[0],
            "position_px": points.points[0],
            "forward_backward_error": points.error[0],
            "position_std_px": np.sqrt(points.variance + curvature)[0],
            "status": points.status[0],
            "in_contact": covered[0],
            **self._since_onset(points, curvature, covered, ellipse),
            "slip_residual": residual * self._per_px,
            "slip_flag": self._slip.slipping,
        }

    def _begin(self, seeding: Seeding, covered: Array) -> None:
        self._seeding = seeding
        # (N,) points that were seeded again on skin already in contact: their onset is not known.
        self._seeded_in_contact = covered & (self._frames > 0)
        if seeding.before is not None:
            self._slip.follow_others(seeding.before, seeding.points)
        self._touches = Touches(len(seeding.points))
        positions = self._on_glass(seeding.points)
        self._entries = Entries(self._engine, positions, self._engine.settings.gauge_length_mm)
        window_px, gauge_px = self._engine.settings.window_px, self._engine.settings.gauge_length_mm / self._per_px
        self._overlap = overlap_gain(seeding.points, window_px, gauge_px)
        self._of_smoothing = math.nan  # variance of the median due to gauge length and border

    def _on_glass(self, pixels: Array) -> Array:
        """Convert positions (..., 2) in px of the topography view to mm on the glass."""
        # Compute each component separately: a product with so small a matrix takes several times as long.
        x, y = pixels[..., 0].astype(np.float64), pixels[..., 1].astype(np.float64)
        result = np.empty(pixels.shape)
        for axis, (by_x, by_y, shift) in enumerate(self._to_glass):
            result[..., axis] = by_x * x + by_y * y + shift
        return result

    def _covariance(self, now: Array, curvature: Array, touch: Touching) -> Array:
        """Return the covariance (1, N, 2, 2) mm^2 of the displacements since the onset of contact, from the variances
        (1, N) px^2 of the present positions, `now` by image noise and `curvature` by displacement that is curved within
        windows, and that at the onset, in `touch`.

        It is larger by the factor by which overlapping windows raise the variance of gradients.
        """
        variance = (touch.displacement_variance(now) + curvature) * np.float32(self._overlap * self._per_px**2)
        return variance[..., None, None] * np.eye(2, dtype=np.float32)

    def _smoothing_variance(
        self, reference: Array, moved: Array, around: FrameEllipse, fields: FrameFields, of_points: float
    ) -> float:
        """Return the variance of the median divergence of `fields` due to the finite gauge length and the uncertain
        contact border: that of `smoothing_variance`, from the change of the median with twice the gauge length, and the
        squared change with a smaller ellipse, less the variance `of_points` by the errors of points.

        In a space of half the size the gauge length counts twice.
        """
        half = around._replace(center=around.center / 2, semi_axes=around.semi_axes / 2)
        smaller = around._replace(semi_axes=around.semi_axes - np.float32(BORDER_MM))
        wide, inner = (
            float(self._engine.fields(*arguments).median[0, 0] - fields.median[0, 0])
            for arguments in ((reference / 2, moved / 2, half), (reference, moved, smaller))
        )
        assert fields.divergence_std is not None
        deviations = fields.divergence_std[0][np.isfinite(fields.divergence_std[0])]
        single = np.median(deviations) if len(deviations) else math.nan
        by_gauge = float(smoothing_variance(wide, of_points, single, fields.divergence[0]))
        return by_gauge + max(inner**2 - of_points, 0.0)

    def _since_onset(
        self, points: TrackedPoints, curvature: Array, covered: Array, ellipse: FrameEllipse
    ) -> dict[str, Any]:
        """Compute divergence, curl and strain at each point from the displacement of the skin since the point's onset
        of contact, and the median divergence over the contact ellipse; return them by result name.

        `curvature` (1, N) px^2 is the variance of the positions that `points` does not hold.
        """
        position = self._on_glass(points.points)
        border = Border(*ellipse)
        touch = self._touches.add_frames(np.array([self._frames]), covered, position, points.variance, border)
        since = self._entries.update(position[0], touch.begins[0], touch.touching[0], touch.position[0], border)
        among = self._entries.entered[None] & touch.touching
        entered = None
        if since is not None and among.any():
            entered = EnteredPoints(
                among, np.where(among[0, :, None, None], since, np.nan).astype(np.float32)[None], None
            )
        moved = (position - touch.position).astype(np.float32)
        around = FrameEllipse(*(values.astype(np.float32) for values in ellipse))
        reference = touch.position[0].astype(np.float32)
        # The graphs of a bundle compute no deviations, and the deviation of advected points is not known.
        covariance = None
        if entered is None and self._engine.deviations:
            covariance = self._covariance(points.variance, curvature, touch)
        fields = self._engine.fields(reference, moved, around, covariance, entered)
        deviation = math.nan
        # The deformation of skin before points were seeded again on it is not known.
        without_onset = (self._seeded_in_contact & touch.touching[0]).sum()
        if fields.median_std is not None and without_onset <= _WITHOUT_ONSET * touch.touching[0].sum():
            of_points = float(fields.median_std[0, 0]) ** 2
            if self._frames % _EVERY == 0 or math.isnan(self._of_smoothing):
                self._of_smoothing = self._smoothing_variance(reference, moved, around, fields, of_points)
            deviation = math.sqrt(of_points + self._of_smoothing + _rank_variance(fields))
        return {
            "divergence": fields.divergence[0],
            "curl": fields.curl[0],
            "point_strain": fields.strain[0],
            "median_divergence": fields.median[0, 0],
            "median_divergence_std": deviation,
            "entered": among[0],
        }


def _rank_variance(fields: FrameFields) -> float:
    """Return the variance of the median divergence due to the part of the contact where divergence is unknown, whose
    values may all lie above or all below the median.

    The median of all lies anywhere between the quantiles 1/2 +- (1 - share) / (2 share) of the known values.
    """
    share, values = float(fields.known_share[0]), np.sort(fields.divergence[0][np.isfinite(fields.divergence[0])])
    if not 0 < share < 1 or not len(values):
        return 0.0
    reach = (1 - share) / (2 * share)
    low, high = np.quantile(values, [max(0.5 - reach, 0), min(0.5 + reach, 1)])
    return float(high - low) ** 2 / 12
