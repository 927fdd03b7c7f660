"""Linear system of an implicit step: an arrow matrix, solved by one banded solve and a 2 x 2 Schur complement.

Each element couples to its neighbours in 2 x 2 blocks and to the bone, whose two rows and columns are dense. Dahl's
force is a function of the slide and no unknown: a third row for it would only be eliminated again.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from fingerflow.models.skin_forces import Array, Chain, Friction, Slopes


class Arrow:
    """Matrix damping I + c K of elements and bone; `solve` and, for derivatives, `solve_transposed`."""

    def __init__(self, chain: Chain, slopes: Slopes, rubbing: Friction, c: float, held: NDArray[np.bool_]) -> None:
        """Assemble the matrix; ``held`` (2,) bool marks directions in which the bone's motion is prescribed."""
        count = len(chain.reference)
        blocks = c * slopes.tissue
        link = c * slopes.link
        blocks[:-1] += link * np.eye(2)
        blocks[1:] += link * np.eye(2)
        blocks[:, 0, 0] += chain.damping + c * rubbing.along
        blocks[:, 0, 1] += c * rubbing.above
        blocks[:, 1, 1] += chain.damping + c * slopes.touching
        band = np.zeros((7, 2 * count))  # row 3 + i - j of column j
        for i in range(2):
            for j in range(2):
                band[3 + i - j, j::2] = blocks[:, i, j]
        band[5, : 2 * count - 2] = -link
        band[1, 2:] = -link
        self.band = band
        self.column = -c * slopes.tissue.reshape(2 * count, 2)  # symmetric blocks: the bone's rows are its transpose
        self.bone = chain.bone_damping * np.eye(2) + c * slopes.tissue.sum(0)
        self.held = held

    def solve(self, elements: Array, bone: Array) -> tuple[Array, Array]:
        """Solve for right-hand sides (N, 2) and (2,); in a held direction the bone's right-hand side is its motion."""
        return self._swept(self.band, elements, bone)

    def solve_transposed(self, elements: Array, bone: Array) -> tuple[Array, Array]:
        """Solve the transposed system; only the plate's friction, which depends on the pressure, is not symmetric."""
        transposed = np.zeros_like(self.band)
        for row in range(7):
            shift = row - 3
            source = self.band[3 - shift]
            if shift >= 0:
                transposed[row, : len(source) - shift] = source[shift:]
            else:
                transposed[row, -shift:] = source[:shift]
        return self._swept(transposed, elements, bone)

    def times(self, elements: Array, bone: Array) -> tuple[Array, Array]:
        """Return the matrix times (N, 2) and (2,), as if no direction were held."""
        flat, total = elements.reshape(-1), np.zeros(elements.size)
        for row in range(7):
            shift = row - 3  # row index minus column index
            low, high = max(0, -shift), len(flat) - max(0, shift)
            total[low + shift : high + shift] += self.band[row, low:high] * flat[low:high]
        return (total + self.column @ bone).reshape(-1, 2), self.column.T @ flat + self.bone @ bone

    def _swept(self, band: Array, elements: Array, bone: Array) -> tuple[Array, Array]:
        sides = np.concatenate((elements.reshape(-1, 1), self.column), 1)
        of = solve_banded((3, 3), band, sides, overwrite_b=True, check_finite=False)
        corner = self.bone - self.column.T @ of[:, 1:]
        right = bone - self.column.T @ of[:, 0]
        free = ~self.held
        moved = np.where(self.held, bone, 0.0)
        if free.any():
            right = right - corner @ moved
            moved[free] = np.linalg.solve(corner[np.ix_(free, free)], right[free])
        return (of[:, 0] - of[:, 1:] @ moved).reshape(-1, 2), moved
