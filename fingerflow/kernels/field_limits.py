"""What local fits and medians over an area ask of their points, and the names of strain measures."""

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

STRAIN_MEASURES = ("green_lagrange", "as_printed", "infinitesimal")

MINIMUM_POINTS = 5
# The weighted standard deviation of the points must be this part of the support's radius in every direction. A uniform
# cloud has 0.35, half a disc across its edge 0.20; collinear, coincident or far off-centre points fall below it.
MINIMUM_SPREAD = 0.1

POSITIONS = 800  # in an ellipse, whatever its size; 8,000 move the median divergence of a press by 0.3 um/mm RMS
# A straight border of a dense cloud has its centroid 0.15 gauge lengths away. Farther out a fit would extrapolate.
FARTHEST_CENTROID = 0.16  # gauge lengths
# Of the area over which the fields must be known for their medians to mean anything. A contact of 5 mm2 among 700
# points has 50: by chance they leave 0.12 of it unknown.
LEAST_SHARE = 0.85
LEAST_RATIO = 0.1  # of areas before and after: less is no skin, but an edge that folds
REACH = 2.0  # standard deviations of a fit within which a position counts as next to the median
SAME_PLACE = 0.5  # radii
EVEN = 0.4  # of sum w^2 d d' to sum w d d' over a disc


@functools.cache
def lattice() -> NDArray[Any]:
    """Return (POSITIONS, 2) float64 places in the unit disc, neighbours near each other in the list.

    Spread evenly: a Fibonacci lattice (Vogel 1979).
    """
    number = np.arange(POSITIONS) + 0.5
    radius, turn = np.sqrt(number / POSITIONS), number * (math.pi * (3 - 5**0.5))
    place = np.stack((radius * np.cos(turn), radius * np.sin(turn)), axis=1)
    # In bands by y, in a band by x: the compiled form takes sixteen at a time.
    bands = round((POSITIONS / 16) ** 0.5)
    ordered = place[place[:, 1].argsort(kind="stable")]
    size = -(-POSITIONS // bands)
    parts = [ordered[first : first + size] for first in range(0, POSITIONS, size)]
    return np.concatenate([band[band[:, 0].argsort(kind="stable")] for band in parts])
