"""Sizes of cells and blocks for the contact, from the radius of the skin pattern; limits of lit glass and of the
apparent contact.

The radius is half the ridge distance or a little more.
"""

# Quantile of a reference image that counts as its full light: the brightest hundredth may be reflections and hot
# pixels.
FULL_LIGHT = 0.99
LEAST_LIGHT = 0.05  # of full light, below which glass counts as not lit
PIXELS_OF_LIGHT = 128  # along the shorter side: some 10,000 pixels suffice for the quantile of smooth light
# Illumination gain (`ops.contact.illumination_gain`)
LINE_STEP = 4  # px between the lines that are read
MOST_GAIN, LEAST_GAIN = 1.4, 0.7  # beyond them changed light cannot be told from covered glass
LIT = 0.25  # least light of a block relative to the brightest block
ROUGH = 0.15  # limit of the deviation of quotients within a block: noise stays below it, ridges exceed it
TOP = 0.03  # least share of the blocks that show glass
WIDTHS = (0.04, 0.02, 0.01, 0.01)  # relative half widths of the windows of the mean shift
# Relative to the gain, blocks of glass lie within NARROW_GLASS. If the mode is skin, about as many lie below it,
# between NARROW_GLASS and BESIDE_GLASS.
NARROW_GLASS, BESIDE_GLASS = 0.02, 0.06
# Apparent contact (`ops.contact.apparent_contact`)
LEAST_SHARE = 0.1  # smallest share of a region that its pattern covers
FIRST_ROUNDS, BORDERS, ROUNDS = 2, 2, 4
NARROW, WIDE = 1.5, 3.0  # widths of the bands inside the border, in widths of the boxes
SOLID = 0.9  # share from which a contact has no valleys, and becomes no thinner towards its rim
THINNING = 0.6  # power of the ratio of the shares in both bands by which the share falls on to the border
BLOCK = 8  # cells, side of the blocks on which components are separated
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
