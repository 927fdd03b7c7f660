"""Variance of medians over the contact that does not come from position errors of the tracked points.

It does not fall with the number of points. Tests with known truth: a press, a slide, and a contact through which skin
passes.
"""

import numpy as np

from fingerflow.engines.engine import Engine, EnteredPoints, FrameEllipse, FrameFields
from fingerflow.kernels.array_types import Array, Series
from fingerflow.tracker.deviations.onset_time import ELLIPSE_MM
from fingerflow.tracker.deviations.smoothing import smoothing_variance

# Of the error of the ellipse's axes, the share by which the border lies too far out or in as a whole: 0.014 mm, as the
# gross area errs by a hundredth. The rest changes the shape, which leaves medians as they are.
_AS_A_WHOLE = 0.4


def bias_variance(
    engine: Engine, reference: Array, displacement: Array, ellipse: FrameEllipse, fields: FrameFields,
    entered: EnteredPoints | None, since_onset: Array,
) -> tuple[Series, FrameFields]:  # fmt: skip
    """Return the variance (n, 5) of the medians of divergence, curl, exx, eyy and exy in n frames by the gauge length
    and by the border, NaN where a contact is too small for twice the gauge length; and the fields with that length.

    The error by the gauge length is that of `smoothing_variance`, from the difference to medians with twice the length.
    The error by the border is the difference to medians over an ellipse whose border lies further in by its error.

    Args:
        engine: computes the medians.
        reference: (N, 2) mm, positions from which displacement counts.
        displacement: (n, N, 2) mm.
        ellipse: of the apparent contact in these frames.
        fields: of these frames, with standard deviations.
        entered: points that were advected into the contact.
        since_onset: (n, 1) whether displacements count from the onsets of contact.
    """
    assert fields.median_std is not None
    # In a space of half the size the gauge length counts twice.
    half = ellipse._replace(center=ellipse.center / 2, semi_axes=ellipse.semi_axes / 2)
    smaller = ellipse._replace(semi_axes=ellipse.semi_axes - ELLIPSE_MM)
    wide = engine.fields(reference / 2, displacement / 2, half, None, entered)
    inner = engine.fields(reference, displacement, smaller, None, entered).median - fields.median
    by_gauge = smoothing_variance(wide.median - fields.median, np.square(fields.median_std), since_onset)
    return by_gauge + np.square(_AS_A_WHOLE * inner), wide


def rank_variance(fields: FrameFields, entered: Array | bool) -> Series:
    """Return the variance (n, 5) of the medians of divergence, curl, exx, eyy and exy over the contact that results
    from parts of the skin in contact whose values are unknown.

    - Where fields are known only in a share of the contact, the median of all of it lies between the quantiles
      1/2 +- (1 - share) / (2 share) of the known values: anywhere, so that the deviation is half of their difference
      over sqrt(3).
    - Where E of the points were advected, the median lies between ranks that are sqrt(E) / 2 points from its own. The
      fields of such a point change within half a gauge length by as much as those of the whole contact, so its area
      falls on either side of the median at random.

    It is 0 in frames where nothing is known and there are no medians. `entered` (n, N) marks the advected points.
    """
    share, result = fields.known_share.astype(np.float64), np.zeros((len(fields.known_share), 5))
    came = np.add.reduce(entered & np.isfinite(fields.divergence), 1)
    # In the other frames both ranks are the same.
    rows = ((share > 0) & ((share < 1) | (came > 0))).nonzero()[0]
    if not len(rows):
        return result
    components = fields.divergence[:, None], fields.curl[:, None], fields.strain.transpose(0, 2, 1)
    values = np.concatenate(components, axis=1)[rows]
    whole = np.isfinite(np.add.reduce(values, 1, keepdims=True))
    # Count ranks from the median of the area: points are denser where skin has texture, so their own median differs.
    ordered = np.where(whole, values, np.float32(np.nan))
    ordered.sort(axis=2)  # NaN last
    count, frame, field = np.add.reduce(whole, 2), np.arange(len(rows))[:, None], np.arange(5)
    ranks, last = np.add.reduce(ordered < fields.median[rows, :, None], 2), np.maximum(count - 1, 0)

    def squared_half_range(reach: Series) -> Series:
        """Return the squared half difference (k, 5) between the values `reach` (k, 1) ranks above and below the median,
        for five deformation fields in k frames.
        """
        low, high = [
            ordered[frame, field, np.minimum(np.maximum(np.rint(ranks + way), 0), last).astype(int)]
            for way in (-reach, reach)
        ]
        return np.where(count > 0, ((high - low) / 2).astype(np.float64) ** 2, 0.0)

    share = share[rows, None]
    result[rows] = squared_half_range(count * (1 - share) / (2 * share)) / 3
    result[rows] += squared_half_range(np.sqrt(came[rows, None]) / 2)
    return result


def strain_deviations(divergence_std: Array, curl_std: Array) -> Array:
    """Return the deviations (..., 3) of exx, eyy and exy from those (...) of divergence and curl, to first order, of
    gradients whose four elements err alike.
    """
    return np.sqrt(divergence_std**2 + curl_std**2)[..., None] / 2 * np.array((1, 1, 0.5**0.5), np.float32)
