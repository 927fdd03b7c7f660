"""What skin that is not known may add to the strain energy."""

import numpy as np
from numpy.typing import NDArray


class MissingEnergy:
    """Error of the energy by triangles in contact that are not known; frames come in the order of time.

    They count with the mean density of the others (`ops.triangle_strain`), and had another when they were known last. A
    point that is lost for a frame has some six of them: on a slide up to 2 % of the energy.
    """

    def __init__(self, areas: NDArray[np.floating]) -> None:
        """``areas`` (M,) mm^2 at the reference."""
        self._area = areas
        self._last = np.zeros(len(areas))  # energy of each by depth, when it was known last

    def see(self, density: NDArray[np.floating], in_contact: NDArray[np.bool_]) -> NDArray[np.float64]:
        """(n,) mJ/mm, of the density (n, M) mJ/mm^3, NaN where it is not known, of triangles that are in contact."""
        result = np.zeros(len(density))
        for k, energies in enumerate(density * self._area):
            known = np.isfinite(energies)
            seen, lost = in_contact[k] & known, in_contact[k] & ~known
            if seen.any() and lost.any():
                mean = energies[seen].sum() / self._area[seen].sum()
                result[k] = abs(self._last[lost].sum() - mean * self._area[lost].sum())
            self._last[known] = energies[known]
        return result
