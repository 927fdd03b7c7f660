"""Linear system of an implicit step: an arrow matrix, solved by one banded solve and a 2 x 2 Schur complement.

Each element couples to its neighbours in 2 x 2 blocks and to the bone, whose two rows and columns are dense. Dahl's
force is a function of the slide and no unknown: a third row for it would only be eliminated again.
"""

import numpy as np
from scipy.linalg import solve_banded

from fingerflow.models.friction import Friction
from fingerflow.models.skin_forces import Array, Chain, tissue_slopes


class Arrow:
    """Arrow-shaped matrix D + c K of an implicit step of a skin chain, with damping D and stiffness K (the negative
    derivative of forces): banded for the elements, bordered by rows and columns for the bone.
    """

    def __init__(self, chain: Chain, nodes: Array, rubbing: Friction, c: float) -> None:
        count = len(chain.reference)
        tissue = c * tissue_slopes(chain, nodes)
        link = c * chain.membrane
        blocks = tissue.copy()
        blocks[:-1] += link * np.eye(2)
        blocks[1:] += link * np.eye(2)
        blocks[:, 0, 0] += chain.damping + c * rubbing.along
        blocks[:, 0, 1] += c * rubbing.above
        blocks[:, 1, 1] += chain.damping + c * np.where(nodes[:-1, 1] < 0, chain.contact, 0.0)
        band = np.zeros((7, 2 * count))  # banded storage: row 3 + i - j, column j
        for i in range(2):
            for j in range(2):
                band[3 + i - j, j::2] = blocks[:, i, j]
        band[5, : 2 * count - 2] = -link
        band[1, 2:] = -link
        self.band = band
        # Columns of the bone; its rows are their transpose, since the blocks are symmetric.
        self.column = -tissue.reshape(2 * count, 2)
        self.bone = chain.bone_damping * np.eye(2) + tissue.sum(0)

    def solve(self, sides: Array) -> Array:
        """Solve the linear system of the matrix for a right-hand side (N + 1, 2); return the solution (N + 1, 2), for
        instance displacements of N elements and the bone.
        """
        elements, bone = sides[:-1].reshape(-1, 1), sides[-1]
        columns = np.concatenate((elements, self.column), 1)
        of = solve_banded((3, 3), self.band, columns, overwrite_b=True, check_finite=False)
        corner = self.bone - self.column.T @ of[:, 1:]
        right = bone - self.column.T @ of[:, 0]
        moved = np.linalg.solve(corner, right)
        return np.concatenate((of[:, 0] - of[:, 1:] @ moved, moved)).reshape(-1, 2)
