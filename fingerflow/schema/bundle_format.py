"""Format version and coordinate convention stated in every file of a deployment bundle and of a recorded stream."""

BUNDLE_FORMAT = 10  # increased whenever a player of another version cannot play a bundle
COORDINATES = (
    "points are (x, y) px with integer pixel centres, x to the right, y down; angles from x towards y; images are "
    "(batch, 1, height, width)"
)
