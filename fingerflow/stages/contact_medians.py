"""Medians of a field over the area of the contact, where the field is known by reference position."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from fingerflow.stages.contact import ContactSeries

_SPACING_MM = 0.15  # of the positions over which a median is taken: a fingertip holds thousands, of which some percent
# more or less on one side move the median of a steep field
_INVERSIONS = 12  # each leaves the strain's share of the error before
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
        """Fields (K, rows * columns) at positions (P, 2), bilinear, (K, P); NaN beside a NaN and beyond the grid."""
        x, y = ((positions - self.origin) / self.step).T
        on_grid = fields.reshape(-1, self.rows, self.columns)
        return np.array([map_coordinates(field, (y, x), order=1, mode="constant", cval=np.nan) for field in on_grid])


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
    nodes = grid.nodes()
    known_nodes = np.isfinite(displacement).all(0)
    if not len(positions) or not known_nodes.any():
        return np.full(len(fields), np.nan)
    # From the node that is nearest now: skin may have moved by more than the contact is wide.
    _, nearest = cKDTree((nodes + displacement.T)[known_nodes]).query(positions)
    reference = positions - displacement.T[known_nodes][nearest]
    for _ in range(_INVERSIONS):
        before, reference = reference, positions - grid.interpolate(displacement, reference).T
        reference = np.where(np.isfinite(reference), reference, before)
    settled = np.linalg.norm(reference - before, axis=1) < grid.step / 10
    values = np.where(settled, grid.interpolate(fields, reference), np.nan)
    known = np.isfinite(values)
    enough = known.mean(axis=1) >= _LEAST_SHARE
    return np.array(
        [np.median(field[some]) if good else np.nan for field, some, good in zip(values, known, enough, strict=True)]
    )


def _positions_inside(contact: ContactSeries, frame: int) -> NDArray[np.float64]:
    """Positions (P, 2) mm on a square grid in the ellipse of the gross contact; a small one gets as many as a large."""
    axes = contact.semi_axes[frame]
    if not (np.isfinite(axes).all() and axes.min() > 0):
        return np.empty((0, 2))
    steps = np.ceil(axes.max() / min(_SPACING_MM, axes.min() / 8))
    offsets = np.arange(-steps, steps + 1) / steps * axes.max()
    right, down = np.meshgrid(offsets, offsets)
    cosine, sine = np.cos(contact.angle[frame]), np.sin(contact.angle[frame])
    along, across = right * cosine + down * sine, down * cosine - right * sine
    inside = (along / axes[0]) ** 2 + (across / axes[1]) ** 2 <= 1
    positions: NDArray[np.float64] = contact.center[frame] + np.stack((right[inside], down[inside]), axis=-1)
    return positions
