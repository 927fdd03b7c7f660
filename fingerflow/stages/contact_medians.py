"""Medians of a field over the area of the contact, where the field is known by reference position."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from fingerflow.stages.contact import ContactSeries

_SPACING_MM = 0.15  # of the positions over which a median is taken: a fingertip holds thousands, of which some percent
# more or less on one side move the median of a steep field
_STEPS = 8  # of Newton's method at most; three or four do within a cell and across its border
_SETTLED = 1e-6  # of a step of the grid: a last step of this size leaves its square
_LEAST_RATIO = 0.1  # of areas after and before: less is no skin, but the edge of what is known
_MOST_STEPS = 200
_LEAST_SHARE = 0.9  # of the contact over which a field must be known for its median to mean anything


@dataclass(frozen=True)
class ReferenceGrid:
    """A square grid of reference positions, mm: first x and y, step, number of columns and rows."""

    origin: NDArray[np.float64]
    step: float
    columns: int
    rows: int

    @classmethod
    def around(cls, positions: NDArray[np.float64], step: float, margin: float) -> "ReferenceGrid | None":
        """Covers the finite positions (N, 2) and a margin; None where there are none."""
        known = positions[np.isfinite(positions).all(-1)]
        if not len(known):
            return None
        low = known.min(0) - margin
        # A contact is some centimetres wide at most; a scale that is wrong by a thousand must not ask for all memory.
        step = max(step, float((known.max(0) - known.min(0)).max()) / _MOST_STEPS)
        columns, rows = np.ceil((known.max(0) + margin - low) / step).astype(int) + 1
        return cls(low, step, int(columns), int(rows))

    def nodes(self) -> NDArray[np.float64]:
        """(rows * columns, 2), row by row."""
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        return self.origin + self.step * np.stack((x, y), axis=-1).reshape(-1, 2)

    def interpolate(self, fields: NDArray[np.float64], positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Fields (K, rows * columns) at positions (2, P), bilinear, (K, P); NaN beside a NaN and beyond the grid."""
        within = ((positions >= self.origin[:, None]) & (positions <= self._end[:, None])).all(0)
        return np.where(within, self._value_and_slopes(fields, positions)[0], np.nan)

    @property
    def _end(self) -> NDArray[np.float64]:
        result: NDArray[np.float64] = self.origin + self.step * np.array([self.columns - 1, self.rows - 1])
        return result

    def _value_and_slopes(
        self, fields: NDArray[np.float64], positions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Bilinear value, and slope along x and y a step, (K, P) each, at (2, P) or the nearest place on the grid."""
        low, high = self.origin[:, None], self._end[:, None]
        x, y = (np.fmin(np.fmax(positions, low), high) - low) / self.step  # in this order a NaN becomes `low`
        column = np.minimum(x.astype(np.intp), self.columns - 2)
        row = np.minimum(y.astype(np.intp), self.rows - 2)
        x, y, node = x - column, y - row, row * self.columns + column
        upper, lower = fields.take(node, axis=1), fields.take(node + self.columns, axis=1)
        upper_slope, lower_slope = (
            fields.take(node + 1, axis=1) - upper,
            fields.take(node + self.columns + 1, axis=1) - lower,
        )
        upper, lower = upper + x * upper_slope, lower + x * lower_slope
        return upper + y * (lower - upper), upper_slope + y * (lower_slope - upper_slope), lower - upper

    def extended(self, fields: NDArray[np.float64]) -> NDArray[np.float64]:
        """Fields (K, rows * columns) with the nearest known node's values where a node has none; one must be known."""
        unknown = ~np.isfinite(fields).all(0).reshape(self.rows, self.columns)
        if not unknown.any():
            return fields
        row, column = distance_transform_edt(unknown, return_distances=False, return_indices=True)
        return fields.take((row * self.columns + column).ravel(), axis=1)

    def led_back(
        self, positions: NDArray[np.float64], displacement: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Reference positions (2, P) of current ones (2, P), by the displacement (2, rows * columns); whether found.

        A reference position and its displacement add up to the current one: Newton's method finds it. Beyond the known
        nodes the nearest one's displacement leads the search, so that it can cross what is not known.
        """
        leading = self.extended(displacement)
        # Skin may have moved by more than the contact is wide.
        reference = positions - np.median(leading, axis=1, keepdims=True)
        found = np.zeros(positions.shape[1], dtype=bool)
        searching, wanted, here = np.arange(len(found)), positions, reference
        for _ in range(_STEPS):
            moved, along_x, along_y = self._value_and_slopes(leading, here)
            missing = wanted - here - moved
            (xx, yx), (xy, yy) = along_x / self.step, along_y / self.step
            ratio = np.maximum((1 + xx) * (1 + yy) - xy * yx, _LEAST_RATIO)
            step = np.stack(((1 + yy) * missing[0] - xy * missing[1], (1 + xx) * missing[1] - yx * missing[0])) / ratio
            here = here + step
            settled = (np.abs(step) < _SETTLED * self.step).all(0)
            found[searching] = settled
            reference[0][searching], reference[1][searching] = here
            others = np.flatnonzero(~settled)
            if not len(others):
                break
            searching, wanted, here = searching.take(others), wanted.take(others, axis=1), here.take(others, axis=1)
        return reference, found


def medians_over_contact(
    contact: ContactSeries,
    frame: int,
    grid: ReferenceGrid,
    displacement: NDArray[np.float64],
    fields: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Medians (K,) over the gross contact of a frame of fields (K, Q) that are known at the nodes of ``grid``.

    The median is that of the area: over evenly spread positions of the current contact, each led back to its reference
    position by the displacement (2, Q) mm of the nodes. Over the tracked points, or over reference positions, it is
    another one: points crowd where skin has texture, and skin that spreads covers more of the area than before. NaN
    where the field is known over less than nine tenths of the contact.
    """
    positions = _positions_inside(contact, frame)
    if not positions.shape[1] or not np.isfinite(displacement).all(0).any():
        return np.full(len(fields), np.nan)
    reference, found = grid.led_back(positions, displacement)
    values = np.where(found, grid.interpolate(fields, reference), np.nan)
    known = np.isfinite(values)
    enough = known.mean(axis=1) >= _LEAST_SHARE
    return np.array(
        [np.median(field[some]) if good else np.nan for field, some, good in zip(values, known, enough, strict=True)]
    )


def _positions_inside(contact: ContactSeries, frame: int) -> NDArray[np.float64]:
    """Positions (2, P) mm on a square grid in the ellipse of the gross contact; a small one gets as many as a large."""
    axes = contact.semi_axes[frame]
    if not (np.isfinite(axes).all() and axes.min() > 0):
        return np.empty((2, 0))
    steps = np.ceil(axes.max() / min(_SPACING_MM, axes.min() / 8))
    offsets = np.arange(-steps, steps + 1) / steps * axes.max()
    right, down = np.meshgrid(offsets, offsets)
    cosine, sine = np.cos(contact.angle[frame]), np.sin(contact.angle[frame])
    along, across = right * cosine + down * sine, down * cosine - right * sine
    inside = (along / axes[0]) ** 2 + (across / axes[1]) ** 2 <= 1
    positions: NDArray[np.float64] = contact.center[frame][:, None] + np.stack((right[inside], down[inside]))
    return positions
