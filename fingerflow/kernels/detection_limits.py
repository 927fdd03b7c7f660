"""Limits for the detection of corners worth tracking (`graphs.detect`)."""

# px, side of the structure tensor's box. A corner must be local: over a tracking window few distinct ones would remain.
BOX = 5
QUALITY = 0.01  # least share of the strongest response
NOISE = 12 / 64 * (1 + 18 / BOX)  # response of pure noise of variance 1 that no window reaches (`ops.tracking.corners`)
LEAST_SIDE = BOX + 2  # px, smallest side of a frame that has a structure tensor
