"""By what a point is judged to be off its neighbours, or far more uncertain than they (`ops.tracking.outliers`)."""

NEIGHBOURS = 16  # of a point that are asked; the nearest
LEAST_NEIGHBOURS = 5  # below which there is nobody to judge by
#: Times its neighbours' disagreement that a point's may be. Of true displacements none in 10,000 exceed it where the
#: field is a plane, and 2 in 1000 where it bends strongly. Of those off by 12 standard deviations 98 in 100 do.
MOST_DISAGREEMENT = 3.0
#: Times the (harmonic) mean standard deviation of its neighbours that a point's may be.
MOST_UNCERTAINTY = 4.0
SPREAD = 4.0  # squared: of agreement, within which a neighbour has at least half a say in the plane
LEAST_DEVIATION = 1e-6  # in the unit of the positions: those of the first frame are 0
RIDGE = 1e-3  # of the spread of neighbours: for those on one line
