"""Limits of the outlier detection among tracked points (`ops.tracking.outliers`)."""

NEIGHBOURS = 16  # nearest neighbours with which a point is compared
LEAST_NEIGHBOURS = 5  # neighbours below which a point is not flagged
#: Largest disagreement of a point, relative to that of its neighbours. It is exceeded by none of 10,000 correct points
#: in a linear field, by 2 in 1000 in a strongly curved one, and by 98 % of the points off by 12 standard deviations.
MOST_DISAGREEMENT = 3.0
#: Largest standard deviation of a point, in units of the (harmonic) mean of those of its neighbours.
MOST_UNCERTAINTY = 4.0
SPREAD = 4.0  # square of the disagreement up to which a neighbour has at least half its weight in the fit of a plane
LEAST_DEVIATION = 1e-6  # least standard deviation of a position, in its unit, since those of the first frame are 0
RIDGE = 1e-3  # regularisation of the fit relative to the spread of the neighbours, for neighbours on one line
