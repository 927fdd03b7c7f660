"""What medians over the contact are uncertain by beside the errors of the points: gauge, border, and what is not known.

None of it falls as there are more points. Tests with truth: a press, a slide and a contact through which skin passes.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.graphs import GrossEllipse
from fingerflow.graphs.fields import Fields
from fingerflow.ops.fields.area_medians import Apart, area_medians
from fingerflow.pipeline.stages.displacement.displacement import DisplacementStage
from fingerflow.pipeline.stages.stage import Batch
from fingerflow.tracker.border import BORDER_MM

EVERY = 8  # frames: what changes as slowly as skin and contact do is looked at so often, and between linear


class MedianBias:
    """Of medians over T frames of divergence, curl and strain (exx, eyy, exy).

    It has four parts:

    - the difference to medians by twice the gauge length. Of smoothing alone it is three times the error, as that goes
      with the square of the length; where the contact has skin of two kinds, so that the median lies in the flank of
      one of them, single fits move it by their noise, which twice the length has a quarter of.
    - the difference to medians over an ellipse that is smaller by what the place of its border is uncertain by.
    - where fields are known in a share of the contact alone, the median of all of it lies between quantiles of what is
      known, 1/2 +- (1 - share) / (2 share): anywhere, of which the deviation is half of their difference over sqrt(3).
    - where E of the points moved in, the median lies between ranks that are sqrt(E) points apart from its own. By the
      fields of such a point, which change by as much as those of the whole contact within half of a gauge length, it is
      a draw on which side of the median the area lies that it stands for; and neighbours share errors of their entry,
      so that four of them are about one. The number is from slides with truth.

    The first two are differences of noisy numbers: what the points' errors make of them, by the deviation of the
    median, is taken off their squares.
    """

    def __init__(self, frames: int, gauge_mm: float, measure: str, moved: DisplacementStage) -> None:
        self._gauge, self._measure = gauge_mm, measure
        self._reference = torch.from_numpy(moved.reference)[None]
        self._looks = np.unique([*range(0, frames, EVERY), frames - 1])  # frames that are looked at
        self._seen = np.full((len(self._looks), 5), np.nan)  # square, of the first two
        self._square = np.zeros((frames, 5))  # of what is not known

    def look(
        self, batch: Batch, found: Fields, displacement: Tensor, ellipse: GrossEllipse, entered: Tensor | None = None
    ) -> None:
        """At these n frames: what was found of these displacements, where points (n, N) `entered` by moving in."""
        assert found.median is not None
        assert found.median_std is not None
        count = None if entered is None else (entered & found.divergence.isfinite()).sum(1).cpu().numpy()
        self._square[batch.indices] = of_ranks(found, count)
        some = np.flatnonzero(np.isin(batch.indices, self._looks))
        if not len(some):
            return
        beside = None if entered is None else Apart(entered[some], _five(found)[some].mT, None)
        center, semi_axes, angle = (one[some] for one in ellipse)
        median, variance = found.median[some], found.median_std[some].square()
        square = torch.zeros_like(median)
        for gauge, smaller in ((2 * self._gauge, 0.0), (self._gauge, BORDER_MM)):
            other = area_medians(
                self._reference.to(displacement),
                displacement[some],
                center,
                semi_axes - smaller,
                angle,
                gauge_length=gauge,
                measure=self._measure,
                apart=beside,
            )
            square += ((other.median - median).square() - variance).clamp_min(0)
        self._seen[np.searchsorted(self._looks, batch.indices[some])] = square.cpu().numpy()

    def square(self) -> NDArray[np.float64]:
        """(T, 5), to be added to the variance.

        Where a contact is too small for twice the gauge length it is that of the nearest frame in which it is not, and
        NaN where that is so all along.
        """
        frames = np.arange(len(self._square))
        result = self._square.copy()
        for column in range(5):
            known = np.isfinite(self._seen[:, column])
            seen = self._seen[known, column]
            result[:, column] += np.interp(frames, self._looks[known], seen) if known.any() else np.nan
        return result


def of_ranks(found: Fields, entered: NDArray[np.integer] | None = None) -> NDArray[np.float64]:
    """(n, 5) variance of the medians by what their ranks are uncertain by, from the fields at points: by the share of
    the contact that is not known, and by so many points (n,) that moved in.

    0 in frames where nothing is known: there are no medians.
    """
    assert found.known_share is not None
    assert found.median is not None
    share, result = found.known_share.cpu().numpy().astype(np.float64), np.zeros((len(found.known_share), 5))
    came = np.zeros(len(share)) if entered is None else np.asarray(entered, dtype=np.float64)
    some = np.flatnonzero((share > 0) & ((share < 1) | (came > 0)))  # else both ranks are one
    if not len(some):
        return result
    fields = _five(found).cpu().numpy()[some]
    whole = np.isfinite(fields.sum(1, keepdims=True))
    # Points crowd where skin has texture, so that their own median is another one: about the rank of the one found.
    ordered = np.where(whole, fields, np.float32(np.nan))
    ordered.sort(axis=2)  # NaN last
    count, frame, field = whole.sum(2), np.arange(len(some))[:, None], np.arange(5)
    ranks = (ordered < found.median.cpu().numpy()[some, :, None]).sum(2)

    def square_between(reach: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of half the difference of fields so many ranks (k, 1) above and below."""
        low, high = (
            ordered[frame, field, np.clip(np.rint(ranks + step), 0, np.maximum(count - 1, 0)).astype(int)]
            for step in (-reach, reach)
        )
        spread = np.asarray((high - low) / 2, dtype=np.float64)
        return np.where(count > 0, spread**2, 0.0)

    share = share[some, None]
    result[some] = square_between(count * (1 - share) / (2 * share)) / 3
    if entered is not None:
        result[some] += square_between(np.sqrt(came[some, None]))
    return result


def _five(found: Fields) -> Tensor:
    """(n, 5, N) divergence, curl and strain of points."""
    return torch.stack((found.divergence, found.curl, *found.strain.unbind(-1)), dim=1)
