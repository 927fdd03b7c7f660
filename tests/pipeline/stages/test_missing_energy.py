"""Tests of the error of the strain energy due to triangles in contact whose strain is unknown."""

import numpy as np

from fingerflow.pipeline.stages.strain.missing_energy import MissingEnergy


def test_lost_triangles_are_missed_by_what_they_had_over_the_mean_and_by_the_spread_of_the_others() -> None:
    """The error of a lost triangle is its last density minus the mean of the others, plus their spread. The known
    densities 1.0 and 1.5 have a mean of 1.25 and a variance of 1/16, and one point may have lost six such triangles.
    """
    missing = MissingEnergy(np.ones(3))
    density = np.array([[1.0, 1.0, 7.0], [1.0, 1.5, np.nan], [1.0, 2.0, np.nan], [1.0, 1.0, 1.0]])
    contact = np.ones((4, 3), dtype=bool)
    contact[2, 2] = False  # not in contact
    np.testing.assert_allclose(missing.add_frames(density, contact), [0, np.hypot(7 - 1.25, np.sqrt(6 / 16)), 0, 0])
