"""What makes a point worth tracking (`graphs.detect`)."""

BOX = 5  # px, of the structure tensor: a corner must be local: averaged over a tracking window few are left apart
QUALITY = 0.01  # least share of the strongest response
NOISE = 12 / 64 * (1 + 18 / BOX)  # response of pure noise of variance 1 that no window reaches (`ops.tracking.corners`)
LEAST_SIDE = BOX + 2  # px of a frame: below it has no structure tensor
