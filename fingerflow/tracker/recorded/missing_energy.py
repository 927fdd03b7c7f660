"""Error of the strain energy by triangles whose strain is unknown."""

import numpy as np

from fingerflow.kernels.array_types import Array, Mask, Series

_OF_A_POINT = 6  # number of triangles that are lost with a point


class MissingEnergy:
    """Estimator of the error of the strain energy that is due to triangles whose strain is unknown.

    Frames must be added in order of time.

    Unknown triangles count with the mean density of the others (`ops.fields.triangle_strain`), but their last known
    density was different, and has changed since. The error has two parts: the difference of both energies, and the
    spread of the density over the known triangles times the area of the lost ones. The triangles of a lost point, some
    six, are all wrong in the same way: their areas add up, those of different points by their squares.
    """

    def __init__(self, areas: Array) -> None:
        """Store the areas (M,) mm^2 of the triangles in the reference configuration."""
        self._area = areas
        self._last = np.zeros(len(areas))  # last known energy per depth of each triangle

    def add_frames(self, density: Array, in_contact: Mask) -> Series:
        """Return the errors (n,) mJ/mm of the strain energy in the next n frames due to triangles in contact of unknown
        strain, from energy densities (n, M) mJ/mm^3 and the mask `in_contact` (n, M).

        Densities are NaN where they are unknown.
        """
        energies, known = np.concatenate((self._last[None], density * self._area)), np.isfinite(density)
        # Row of `energies` in which the energy of each triangle was known last.
        when = np.where(np.isfinite(energies), np.arange(len(energies))[:, None], 0)
        last = np.take_along_axis(energies, np.maximum.accumulate(when), axis=0)
        self._last = last[-1]
        seen, lost = self._area * (in_contact & known), self._area * (in_contact & ~known)
        with np.errstate(invalid="ignore"):  # where no triangle is known
            share = seen / seen.sum(1, keepdims=True)
        mean = (share * np.where(known, density, 0)).sum(1, keepdims=True)
        spread = (share * np.where(known, density - mean, 0) ** 2).sum(1)
        change = np.where(lost > 0, last[1:] - mean * lost, 0).sum(1)
        return np.nan_to_num(np.sqrt(change**2 + _OF_A_POINT * spread * (lost**2).sum(1)))
