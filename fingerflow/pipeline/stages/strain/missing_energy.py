"""Error of the strain energy caused by triangles in contact whose strain is unknown."""

import numpy as np
from numpy.typing import NDArray

_OF_A_POINT = 6  # number of triangles that are lost with a point


class MissingEnergy:
    """Estimator of the error of the strain energy that triangles with unknown strain cause.

    Frames must be added in order of time.

    Unknown triangles count with the mean density of the others (`ops.fields.triangle_strain`), but their last known
    density was different, and has changed since. The error has two parts: the difference of both energies, and the
    spread of the density over the known triangles times the area of the lost ones. The triangles of a lost point, some
    six, are all wrong in the same way: their areas add up, those of different points by their squares.
    """

    def __init__(self, areas: NDArray[np.floating]) -> None:
        """Store the areas (M,) mm^2 of the triangles in the reference configuration."""
        self._area = areas
        self._last = np.zeros(len(areas))  # last known energy per depth of each triangle

    def add_frames(self, density: NDArray[np.floating], in_contact: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the errors (n,) mJ/mm of the strain energy in the next n frames due to triangles in contact of unknown
        strain, from energy densities (n, M) mJ/mm^3 and the mask `in_contact` (n, M).

        Densities are NaN where they are unknown.
        """
        result, energies = np.zeros(len(density)), density * self._area
        finite = np.isfinite(energies)
        seen, lost = in_contact & finite, in_contact & ~finite
        triangles = np.flatnonzero(lost.any(0))  # triangles that are lost in any of these frames
        if len(triangles):
            # Row of `energies`, counted from 1, in which the energy of each triangle was known last.
            number = np.arange(1, len(density) + 1)[:, None]
            when = np.maximum.accumulate(np.where(finite[:, triangles], number, 0), axis=0)
            last = np.where(when > 0, energies[when - 1, triangles], self._last[triangles])
            for k in np.flatnonzero(seen.any(1) & lost.any(1)):
                seen_area = self._area[seen[k]]
                mean = energies[k, seen[k]].sum() / seen_area.sum()
                gone = self._area[lost[k]]
                spread = seen_area @ np.square(density[k, seen[k]] - mean) / seen_area.sum()
                change = last[k, lost[k, triangles]].sum() - mean * gone.sum()
                result[k] = np.sqrt(change**2 + _OF_A_POINT * spread * np.square(gone).sum())
        triangles = np.flatnonzero(finite.any(0))
        self._last[triangles] = energies[len(energies) - 1 - finite[::-1].argmax(0)[triangles], triangles]
        return result
