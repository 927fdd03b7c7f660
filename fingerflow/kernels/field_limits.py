"""Limits for valid local fits and area medians, and names of the strain measures."""

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

STRAIN_MEASURES = ("green_lagrange", "as_printed", "infinitesimal")

MINIMUM_POINTS = 5
# The weighted standard deviation of the points must be this part of the support's radius in every direction. A uniform
# cloud has 0.35, half a disc across its edge 0.20; collinear, coincident or far off-centre points have less.
MINIMUM_SPREAD = 0.1

POSITIONS = 800  # in an ellipse, whatever its size; 8,000 move the median divergence of a press by 0.3 um/mm RMS
# A straight border of a dense cloud has its centroid 0.15 gauge lengths away. Farther out a fit would extrapolate.
FARTHEST_CENTROID = 0.16  # gauge lengths
# Share of the area in which the fields must be known for a valid median. A contact of 5 mm2 among 700 points has 50 of
# them: by chance they leave 0.12 of it unknown.
LEAST_SHARE = 0.85
LEAST_RATIO = 0.1  # of areas before and after: less is no deformation of skin, but an edge that folds
REACH = 2.0  # standard deviations of a fit within which a position counts as next to the median
SAME_PLACE = 0.5  # radii
EVEN = 0.4  # of sum w^2 d d' to sum w d d' over a disc


@functools.cache
def lattice() -> NDArray[Any]:
    """Return sampling positions (POSITIONS, 2) float64, spread evenly over the unit disc by a Fibonacci lattice.

    Source: Vogel 1979. Neighbours are close to each other in the list.
    """
    number = np.arange(POSITIONS) + 0.5
    radius, turn = np.sqrt(number / POSITIONS), number * (math.pi * (3 - 5**0.5))
    place = np.stack((radius * np.cos(turn), radius * np.sin(turn)), axis=1)
    # Sorted into bands of y, and by x within a band: the compiled kernel takes sixteen at a time.
    bands = round((POSITIONS / 16) ** 0.5)
    ordered = place[place[:, 1].argsort(kind="stable")]
    size = -(-POSITIONS // bands)
    parts = [ordered[first : first + size] for first in range(0, POSITIONS, size)]
    return np.concatenate([band[band[:, 0].argsort(kind="stable")] for band in parts])
