"""Limits for valid local fits and area medians, and names of the strain measures."""

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

STRAIN_MEASURES = ("green_lagrange", "as_printed", "infinitesimal")

MINIMUM_POINTS = 5
# Least weighted standard deviation of the points as a share of the support's radius, in every direction. A uniform
# cloud has 0.35, half a disc across its edge 0.20; collinear, coincident or far off-centre points have less.
MINIMUM_SPREAD = 0.1

# Sampling positions in the contact ellipse, whatever its size; 8,000 change the median divergence of a press by
# 0.3 um/mm RMS.
POSITIONS = 800
# Largest distance of the points' centroid from the position of a fit. At a straight border of a dense cloud it is 0.15
# gauge lengths; a fit with a centroid farther away would extrapolate.
FARTHEST_CENTROID = 0.16  # gauge lengths
# Least share of the area in which the fields must be known for a valid median. A contact of 5 mm2 among 700 points has
# 50 of them: by chance they leave the fields unknown in 0.12 of the area.
LEAST_SHARE = 0.85
# Least ratio of the area before deformation to that after it; below, the fit at an edge folds and is no deformation of
# skin.
LEAST_RATIO = 0.1
# Distance from the median, in standard deviations of a fit, up to which a position contributes to the median's error.
REACH = 2.0
# Largest distance, in radii of the support, of a position from the nearest point or position if it takes the fields
# known there.
SAME_PLACE = 0.5
# A plane fit keeps h1 = 384 J4(k)/k^4 = 1 - k^2/20 + ... of a wave's slope, and h0 = 48 J3(k)/k^3 = 1 - k^2/16 + ... of
# its value, k = pi gauge length / wavelength. Sharpened displacements u + s (u - v), v the value of the fit at the
# point, keep h1 (1 + s (1 - h0)) of the slope, without a term in k^2 if s = 16/20 (twicing, Tukey 1977). The variance
# of a gradient by white noise, the integral of the square of k times this, is 2.2 times as large.
SHARPENED, SHARPENED_NOISE = 0.8, 2.2
EVEN = 0.4  # ratio of sum w^2 d d' to sum w d d' over a disc, for fit weights w and offsets d


@functools.cache
def lattice() -> NDArray[Any]:
    """Return sampling positions (POSITIONS, 2) float64, spread evenly over the unit disc by a Fibonacci lattice.

    Source: Vogel 1979. Neighbours are close to each other in the list.
    """
    number = np.arange(POSITIONS) + 0.5
    radius, turn = np.sqrt(number / POSITIONS), number * (math.pi * (3 - 5**0.5))
    place = np.stack((radius * np.cos(turn), radius * np.sin(turn)), axis=1)
    # Sort into bands of y, and by x within a band, so that the sixteen positions that the kernel takes together are
    # close to each other.
    bands = round((POSITIONS / 16) ** 0.5)
    ordered = place[place[:, 1].argsort(kind="stable")]
    return np.concatenate([band[band[:, 0].argsort(kind="stable")] for band in np.array_split(ordered, bands)])
