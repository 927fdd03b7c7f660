"""Limits for the detection of corners worth tracking (`graphs.detect`)."""

# Side of the structure tensor's box, px. A corner must be local: with a box as large as a tracking window few distinct
# ones would remain.
BOX = 5
QUALITY = 0.01  # least response of a corner as a share of the strongest one
# Upper bound of the corner response of white noise with variance 1 (`ops.tracking.corners`).
NOISE = 12 / 64 * (1 + 18 / BOX)
