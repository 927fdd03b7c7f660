"""Uncertainty of medians over the contact that does not come from position errors of the tracked points.

It does not fall with the number of points. Tests with known truth: a press, a slide, and a contact through which skin
passes.
"""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from fingerflow.engines.engine import FrameEllipse, FrameFields
from fingerflow.ops.fields.area_medians import Apart, area_medians
from fingerflow.pipeline.stages.displacement.displacement_stage import DisplacementStage
from fingerflow.pipeline.stages.preparation.series import nanmedian
from fingerflow.pipeline.stages.stage import Batch
from fingerflow.tracker.contact_border import BORDER_MM
from fingerflow.tracker.median_smoothing import smoothing_variance

Array = NDArray[Any]

EVERY = 8  # frames between two evaluations, interpolated linearly, as skin and contact change slowly


class MedianBias:
    """Variance of the medians of divergence, curl and strain in T frames that position errors do not explain.

    It has four parts:

    - the error by the gauge length (`smoothing_variance`), from the difference to medians with twice the length.
    - the difference to medians over an ellipse that is smaller by the uncertainty of the border's position.
    - where fields are known only in a share of the contact, the median of all of it lies between the quantiles
      1/2 +- (1 - share) / (2 share) of the known values: anywhere, so that the deviation is half of their difference
      over sqrt(3).
    - where E of the points were advected, the median lies between ranks that are sqrt(E) points from its own. The
      fields of such a point change within half a gauge length by as much as those of the whole contact, so its area
      falls on either side of the median at random. Neighbours share errors of their entry, so that four of them count
      as about one. The number is from slides with known truth.

    The first two are differences of noisy numbers: the variance of the median by errors of points is subtracted from
    their squares.
    """

    def __init__(self, frames: int, gauge_mm: float, measure: str, moved: DisplacementStage) -> None:
        self._gauge, self._measure = gauge_mm, measure
        self._reference = torch.from_numpy(moved.reference)[None]
        self._looks = np.unique([*range(0, frames, EVERY), frames - 1])  # indices of the evaluated frames
        # Variance due to gauge length and border in the evaluated frames.
        self._seen = np.full((len(self._looks), 5), np.nan)
        self._square = np.zeros((frames, 5))  # variance due to unknown and advected skin

    def add(
        self,
        batch: Batch,
        fields: FrameFields,
        displacement: Array,
        ellipse: FrameEllipse,
        entered: Array | None = None,
    ) -> None:
        """Add n frames to the estimate, given the fields `fields` at N points, displacements (n, N, 2) mm and contact
        ellipses; the mask `entered` (n, N) marks points advected into the contact.
        """
        assert fields.median_std is not None
        components = _stack_components(fields)
        count = None if entered is None else (entered & np.isfinite(fields.divergence)).sum(1)
        self._square[batch.indices] = rank_variance(fields, components, count)
        rows = np.flatnonzero(np.isin(batch.indices, self._looks))
        if not len(rows):
            return
        excluded = None
        if entered is not None:
            excluded = Apart(torch.from_numpy(entered[rows]), torch.from_numpy(components[rows]).mT, None)
        center, semi_axes, angle = (torch.from_numpy(values[rows]) for values in ellipse)
        moved = torch.from_numpy(displacement[rows])
        variance = np.square(fields.median_std[rows])
        wide, inner = (
            area_medians(
                *(self._reference.to(moved), moved, center, semi_axes - smaller, angle),
                gauge_length=gauge,
                measure=self._measure,
                apart=excluded,
            ).median.numpy()
            - fields.median[rows]
            for gauge, smaller in ((2 * self._gauge, 0.0), (self._gauge, BORDER_MM))
        )
        by_gauge = smoothing_variance(wide, variance, _fit_deviations(fields)[rows], components[rows])
        by_border = np.maximum(np.square(inner) - variance, 0)
        self._seen[np.searchsorted(self._looks, batch.indices[rows])] = by_gauge + by_border

    def variance(self) -> NDArray[np.float64]:
        """Return the variance (T, 5) of the medians of divergence, curl, exx, eyy and exy, without the part due to
        position errors.

        Where a contact is too small for twice the gauge length, the nearest frame in which it is large enough is used;
        NaN if there is none.
        """
        frames = np.arange(len(self._square))
        result = self._square.copy()
        for column in range(5):
            finite = np.isfinite(self._seen[:, column])
            seen = self._seen[finite, column]
            result[:, column] += np.interp(frames, self._looks[finite], seen) if finite.any() else np.nan
        return result


def rank_variance(fields: FrameFields, components: Array, entered: Array | None = None) -> NDArray[np.float64]:
    """Return the variance (n, 5) of the medians of divergence, curl, exx, eyy and exy over the contact that results
    from parts of the skin in contact whose values are unknown.

    Such skin makes the rank of the median uncertain.

    Its causes are the unknown share of the contact and the number (n,) of advected points. It is 0 in frames where
    nothing is known and there are no medians.
    """
    share, result = fields.known_share.astype(np.float64), np.zeros((len(fields.known_share), 5))
    came = np.zeros(len(share)) if entered is None else np.asarray(entered, dtype=np.float64)
    rows = np.flatnonzero((share > 0) & ((share < 1) | (came > 0)))  # in the other frames both ranks are the same
    if not len(rows):
        return result
    values = components[rows]
    whole = np.isfinite(values.sum(1, keepdims=True))
    # Count ranks from the median of the area: points are denser where skin has texture, so their own median differs.
    ordered = np.where(whole, values, np.float32(np.nan))
    ordered.sort(axis=2)  # NaN last
    count, frame, field = whole.sum(2), np.arange(len(rows))[:, None], np.arange(5)
    ranks = (ordered < fields.median[rows, :, None]).sum(2)

    def squared_half_range(reach: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the squared half difference (k, 5) between the values `reach` (k, 1) ranks above and below the median,
        for five deformation fields in k frames.
        """
        low, high = (
            ordered[frame, field, np.clip(np.rint(ranks + step), 0, np.maximum(count - 1, 0)).astype(int)]
            for step in (-reach, reach)
        )
        spread = np.asarray((high - low) / 2, dtype=np.float64)
        return np.where(count > 0, spread**2, 0.0)

    share = share[rows, None]
    result[rows] = squared_half_range(count * (1 - share) / (2 * share)) / 3
    if entered is not None:
        result[rows] += squared_half_range(np.sqrt(came[rows, None]))
    return result


def _fit_deviations(fields: FrameFields) -> NDArray[np.float64]:
    """Return the typical deviations (n, 5) of a fitted divergence, curl, exx, eyy and exy by the errors of points,
    those of gradients whose four elements err alike.
    """
    assert fields.divergence_std is not None
    assert fields.curl_std is not None
    divergence, curl = (nanmedian(values) for values in (fields.divergence_std, fields.curl_std))
    of_element = np.sqrt((divergence**2 + curl**2) / 4)
    return np.stack((divergence, curl, of_element, of_element, of_element / np.sqrt(2)), axis=1)


def _stack_components(fields: FrameFields) -> Array:
    """Stack divergence, curl, exx, eyy and exy of N points in n frames to an array (n, 5, N)."""
    return np.stack((fields.divergence, fields.curl, *np.moveaxis(fields.strain, -1, 0)), axis=1)
