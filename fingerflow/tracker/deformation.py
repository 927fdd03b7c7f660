"""Results of consecutive frames from the points tracked in them: displacement since the onset of contact, its fields,
their medians over the contact, and the standard deviations of all.

`Deformation.step` is their only composition. Recordings call it with many frames, streams with one. What a caller knows
of the onsets of contact, such as which touch lasts, is in its `Onsets`.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from fingerflow.engines.engine import Engine, EnteredPoints, FrameEllipse, FrameFields
from fingerflow.kernels.array_types import Array
from fingerflow.tracker.deviations.medians import bias_variance, rank_variance
from fingerflow.tracker.deviations.onset_time import displacement_covariance
from fingerflow.tracker.deviations.smoothing import SmoothingErrors
from fingerflow.tracker.displacement_medians import displacement_medians
from fingerflow.tracker.points import select_frames

#: Frames between two evaluations of what changes slowly: errors by gauge length and border.
EVERY = 8
_GROWN = 1.5  # growth of the contact after which they are evaluated sooner, as in streams of a slow camera
# Errors of the medians of divergence, curl, exx, eyy and exy that tracked points have in common as their skin begins to
# touch and looks different. Light and contrast of the ridges vary across a window near the border, so that positions at
# onset are off towards the contact. Measured on presses with hardly any deformation, of real prints and the skin chain.
_COMMON = 1e-4 * np.array((6.4, 2.1, 2.3, 2.3, 1.1))


class SkinFrames(NamedTuple):
    """Tracked points of the skin in n consecutive frames.

    Attributes:
        numbers: (n,) of the frames.
        covered: (n, N) whether the contact covers each point.
        position: (n, N, 2) mm, NaN where lost.
        noise, curvature: (n, N) px^2, variances of a component by image noise, and by displacement that is curved
            within windows.
        border: of the apparent contact, mm.
    """

    numbers: Array
    covered: Array
    position: Array
    noise: Array
    curvature: Array
    border: FrameEllipse


class Displacement(NamedTuple):
    """Displacement of N points in n frames from their reference, as far as it is known, with its error model.

    Attributes:
        reference: (N, 2) mm, position from which displacement counts.
        displacement: (n, N, 2) mm; NaN where it is not known.
        variance, curvature: (n, N) mm^2, of a component, by image noise, and by displacement that is curved within
            windows.
        onset: (n, N, 2, 2) or (N, 2, 2) mm^2, covariance by the error of the time of onset.
        gain: (N,) factor by which overlapping windows raise the variance of gradients (`OverlapErrors.variance_gain`).
        entered: points that were advected into the contact, with gradients since their entry; None if there are none.
        late: (n, 2, N) or (2, N), variance of divergence and curl of these points by the error of the time of entry, 0
            for others.
        unseen: (n, N) mm^2, variance of a component by touches that may have begun before they were seen.
        passing: (n, N) bool, touches that do not last: beside skin that has been dragged along, they are no strain.
    """

    reference: Array
    displacement: Array
    variance: Array
    curvature: Array
    onset: Array
    gain: Array
    entered: EnteredPoints | None
    late: Array
    unseen: Array | float = 0.0
    passing: Array | None = None

    def lasting(self) -> Displacement:
        """Return the displacement without touches that do not last."""
        if self.passing is None:
            return self
        displacement, variance = self.displacement.copy(), self.variance.copy()
        displacement[self.passing] = variance[self.passing] = np.nan
        return self._replace(displacement=displacement, variance=variance)


class Onsets(Protocol):
    """What is known of the times and positions at which points came into contact."""

    def since(self, skin: SkinFrames) -> Displacement:
        """Return the displacements in the next frames, which are given in order."""


class DeformedFrames(NamedTuple):
    """Displacements, fields and medians of n frames, with their errors.

    Attributes:
        since: displacements of the points.
        lasting: the same without touches that do not last.
        square: (n, N) mm^2, mean square error of a displacement component.
        vector, vector_std: (n, 2) mm, median displacement over the contact, and its standard deviation.
        fields: with the standard deviations of divergence and curl at points by all terms, and of medians by errors of
            points alone.
        variance: (n, 5) of the medians of fields by all terms but gauge length and border.
        bias: (n, 5) of the medians by gauge length and border, as it was known in each frame (`Deformation.latest`).
    """

    since: Displacement
    lasting: Displacement
    square: Array
    vector: Array
    vector_std: Array
    fields: FrameFields
    variance: Array
    bias: Array


class Deformation:
    """Composition of the results of frames, one by one or several at a time; frames are given in order.

    Args:
        engine: computes the fits.
        positions: (N, 2) mm, positions by which points are neighbours, the same in all frames; NaN for no point.

    Attributes:
        latest: (5,) the latest known variance of the medians by gauge length and border; NaN as long as the contact is
            too small for twice the gauge length. Every eighth frame is evaluated, and one in which the contact has
            grown. Until it is known in one, every frame is evaluated.
    """

    def __init__(self, engine: Engine, positions: Array) -> None:
        self._engine, self._smoothing = engine, SmoothingErrors(engine.settings.gauge_length_mm, positions)
        # Variance of divergence and curl in the latest evaluated frame, the mean square of these fields and the product
        # of the contact's semi-axes in it.
        self._of_smoothing, self._square = np.zeros((1, 2, len(positions))), np.ones(1)
        self.latest, self._area = np.full(5, np.nan), 0.0

    def step(self, skin: SkinFrames, onsets: Onsets) -> DeformedFrames:
        """Compute the results of n frames from the points tracked in them and what is known of their onsets."""
        since = onsets.since(skin)
        onset = (since.onset[..., 0, 0] + since.onset[..., 1, 1]) / 2
        square = since.variance + since.curvature + onset + since.unseen
        reach = self._engine.settings.gauge_length_mm / 2
        vector, vector_std = displacement_medians(skin.position, since.displacement, square, skin.border, reach)
        lasting = since.lasting()
        fields, variance, bias = self._fields(skin.numbers, lasting, skin.border)
        return DeformedFrames(since, lasting, square, vector, vector_std, fields, variance, bias)

    def _fields(self, frames: Array, since: Displacement, ellipse: FrameEllipse) -> tuple[FrameFields, Array, Array]:
        """Compute divergence, curl and strain in the frames with the numbers `frames` (n,), the variances (n, 5) of the
        medians of these fields over the contact, and `DeformedFrames.bias`.
        """
        moved, reference = since.displacement.astype(np.float32), since.reference.astype(np.float32)
        noise = since.variance + since.curvature
        ellipse = FrameEllipse(*[values.astype(np.float32) for values in ellipse])
        covariance = displacement_covariance(noise, since.onset) * since.gain[:, None, None]
        entered = since.entered
        fields = self._engine.fields(reference, moved, ellipse, covariance, entered)
        ranks = rank_variance(fields, entered is not None and entered.among)
        known = np.isfinite(fields.median[:, 0])
        # What is evaluated depends on a frame and those before it alone, so that no result depends on the batch.
        evaluated, area = np.zeros(len(frames), bool), ellipse.semi_axes.prod(1)
        smoothing, course = [self._of_smoothing], [self.latest]

        def evaluate(rows: Array) -> None:
            part, around = select_frames(fields, rows), ellipse.select(rows)
            excluded = None if entered is None else EnteredPoints(entered.among[rows], entered.gradient[rows], None)
            # True in frames in which the displacements of most points count from their onsets.
            known_points = np.isfinite(moved[rows, :, 0])
            counted = known_points & (np.broadcast_to(since.onset[..., 0, 0], noise.shape)[rows] > 0)
            since_onset = counted.sum(1, keepdims=True) > known_points.sum(1, keepdims=True) / 2
            bias, wide = bias_variance(self._engine, reference, moved[rows], around, part, excluded, since_onset)
            bias += np.where(since_onset, np.square(_COMMON), 0)
            for values in bias:
                course.append(np.where(np.isfinite(values), values, course[-1]))
            self.latest = course[-1]
            plain = reference
            if excluded is not None:
                plain = np.where(excluded.among[..., None], np.float32(np.nan), reference)
            smoothing.append(self._smoothing.variance(plain, moved[rows], part, wide))

        for row in known.nonzero()[0]:
            unknown = np.isnan(self.latest[0])
            if unknown or frames[row] % EVERY == 0 or area[row] > _GROWN * self._area:
                evaluated[row], self._area = True, area[row]
                if unknown:
                    evaluate(np.array([row]))
        rows = evaluated.nonzero()[0]
        if len(rest := rows[len(course) - 1 :]):
            evaluate(rest)
        of_smoothing = np.concatenate(smoothing)
        self._of_smoothing = of_smoothing[-1:]
        # The latest evaluated frame counts, 0 being the one before these. What smoothing takes grows as fields do,
        # which grow fourfold at most until the next.
        square = np.square(fields.divergence) + np.square(fields.curl)
        valid = np.isfinite(square)
        size = np.add.reduce(np.where(valid, square, 0), 1, float) / np.maximum(np.add.reduce(valid, 1), 1) + 1e-30
        sizes, latest = np.concatenate((self._square, size[rows])), evaluated.cumsum()
        self._square = sizes[-1:]
        growth = np.minimum(np.maximum(size / sizes[latest], 1), 16)
        of_fields = of_smoothing[latest] * growth[:, None, None] + since.late
        assert fields.divergence_std is not None
        assert fields.curl_std is not None
        # Of skin that stuck before it slips: errors by curvature have opposite signs on both sides of an edge of slip,
        # so that they add up in a gradient.
        opposed = 1 + (since.onset[..., 0, 0] == 0) * since.curvature / np.maximum(noise, 1e-30)
        divergence_std = np.sqrt(fields.divergence_std**2 * opposed + of_fields[:, 0])
        curl_std = np.sqrt(fields.curl_std**2 * opposed + of_fields[:, 1])
        assert fields.median_std is not None
        variance = np.square(fields.median_std) + ranks
        return fields._replace(divergence_std=divergence_std, curl_std=curl_std), variance, np.array(course)[latest]
