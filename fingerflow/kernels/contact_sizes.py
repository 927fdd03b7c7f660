"""Sizes that follow from the radius of a pattern, half the distance between its ridges or a little more; and which
glass is lit.
"""

# The brightest hundredth of a reference may be reflections and hot pixels; its full light is taken below them.
FULL_LIGHT = 0.99
LEAST_LIGHT = 0.05  # of full light, at which a quotient means anything
PIXELS_OF_LIGHT = 128  # along the shorter side: some 10,000 pixels tell the quantile of smooth light
_LEAST_BLOCK = 16  # px, wide enough for a ridge and the skin beside it


def cell_of(radius: int) -> int:
    """Return the side (px) of the cells on which a pattern of this radius is followed: 4, less for fine patterns."""
    return max(cell for cell in (1, 2, 4) if cell == 1 or 4 * cell <= 2 * radius + 1)


def block_of(radius: int) -> int:
    """Return the side (px) of the blocks in which `light_gain` compares a frame with the empty glass."""
    return max(_LEAST_BLOCK, (2 * radius + 1) // 8 * 8)
