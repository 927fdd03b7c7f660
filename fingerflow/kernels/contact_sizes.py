"""Sizes of cells and blocks for the contact, from the radius of the skin pattern; limits of lit glass.

The radius is half the ridge distance or a little more.
"""

# Quantile of a reference image that counts as its full light: the brightest hundredth may be reflections and hot
# pixels.
FULL_LIGHT = 0.99
LEAST_LIGHT = 0.05  # of full light, below which glass counts as not lit
PIXELS_OF_LIGHT = 128  # along the shorter side: some 10,000 pixels suffice for the quantile of smooth light
_LEAST_BLOCK = 16  # px, wide enough for a ridge and the skin beside it


def cell_of(radius: int) -> int:
    """Return the side in px of the square cells on which the apparent contact is computed, from the radius of the skin
    pattern, px: 4 px, less for fine skin patterns.
    """
    return max(cell for cell in (1, 2, 4) if cell == 1 or 4 * cell <= 2 * radius + 1)


def block_of(radius: int) -> int:
    """Return the side in px of the blocks in which `illumination_gain` compares frames with the empty glass, from the
    radius of the skin pattern, px.
    """
    return max(_LEAST_BLOCK, (2 * radius + 1) // 8 * 8)
