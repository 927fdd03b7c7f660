"""Medians of a field over the area of the contact, where the field is known by reference position."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fingerflow.ops.area_medians import area_medians
from fingerflow.stages.contact import ContactSeries

_SPACING_MM = 0.15  # of the positions over which a median is taken: a fingertip holds thousands, of which some percent
# more or less on one side move the median of a steep field
_MOST_STEPS = 200


@dataclass(frozen=True)
class ReferenceGrid:
    """A square grid of reference positions, mm: x and y of the first, step, number of columns and rows."""

    origin: tuple[float, float]
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
        return cls((float(low[0]), float(low[1])), step, int(columns), int(rows))

    def nodes(self) -> NDArray[np.float64]:
        """(rows * columns, 2), row by row."""
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        steps = np.stack((x, y), axis=-1).reshape(-1, 2)
        result: NDArray[np.float64] = np.array(self.origin) + self.step * steps
        return result


def medians_over_contact(
    contact: ContactSeries, frames: slice, grid: ReferenceGrid, displacement: Tensor, fields: Tensor
) -> NDArray[np.float64]:
    """Medians (n, K) over the gross contact of n frames, of fields (n, Q, K) that are known at the nodes of ``grid``.

    The median is that of the area: over evenly spread positions of the current contact, each led back to its reference
    position by the displacement (n, Q, 2) mm of the nodes. Over the tracked points it is another one: they crowd where
    skin has texture. NaN where the field is known over less than nine tenths of the contact.
    """
    center, semi_axes, angle = (
        torch.from_numpy(values[frames]).to(fields.device)
        for values in (contact.center, contact.semi_axes, contact.angle)
    )
    on_grid, moved = (nodes.mT.unflatten(2, (grid.rows, grid.columns)) for nodes in (fields, displacement))
    medians = area_medians(on_grid, moved, grid.origin, grid.step, center, semi_axes, angle, _SPACING_MM)
    result: NDArray[np.float64] = medians.cpu().numpy()
    return result
