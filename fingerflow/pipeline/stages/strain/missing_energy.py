"""What skin that is not known may add to the strain energy."""

import numpy as np
from numpy.typing import NDArray


class MissingEnergy:
    """Error of the energy by triangles in contact that are not known; frames come in the order of time.

    They count with the mean density of the others (`ops.fields.triangle_strain`), and had another when they were known
    last. A point that is lost for a frame has some six of them: on a slide up to 2 % of the energy.
    """

    def __init__(self, areas: NDArray[np.floating]) -> None:
        """``areas`` (M,) mm^2 at the reference."""
        self._area = areas
        self._last = np.zeros(len(areas))  # energy of each by depth, when it was known last

    def see(self, density: NDArray[np.floating], in_contact: NDArray[np.bool_]) -> NDArray[np.float64]:
        """(n,) mJ/mm, of the density (n, M) mJ/mm^3, NaN where it is not known, of triangles that are in contact."""
        result, energies = np.zeros(len(density)), density * self._area
        known = np.isfinite(energies)
        seen, lost = in_contact & known, in_contact & ~known
        some = np.flatnonzero(lost.any(0))  # triangles that are lost in a frame
        if len(some):
            # The row of `energies` in which each was known last before a frame, counted from 1.
            number = np.arange(1, len(density) + 1)[:, None]
            when = np.maximum.accumulate(np.where(known[:, some], number, 0), axis=0)
            last = np.where(when > 0, energies[when - 1, some], self._last[some])
            for k in np.flatnonzero(seen.any(1) & lost.any(1)):
                mean = energies[k, seen[k]].sum() / self._area[seen[k]].sum()
                result[k] = abs(last[k, lost[k, some]].sum() - mean * self._area[lost[k]].sum())
        some = np.flatnonzero(known.any(0))
        self._last[some] = energies[len(energies) - 1 - known[::-1].argmax(0)[some], some]
        return result
