"""Sizes of an exhaustive search (`ops.tracking.search`), which works on images of half resolution."""

# The template of a wide search is this many tracking windows wide. Ridges repeat every 15 px: 21 px hold little more
# than one of them and match the neighbouring ridge almost as well; 63 px hold the bends and endings that tell them
# apart. Within a few px there is no neighbouring ridge.
_WIDENING = 3
SEARCHED = 1.0  # px of the full image that a search is good to


def sizes_of(window: int, radius: int) -> tuple[int, int]:
    """Return the odd side of the template and how far it is searched for, at half resolution, of a tracking window
    (px) and a radius (px) in x and y.
    """
    return 2 * (min(_WIDENING * window, window + 2 * radius) // 4) + 1, (radius + 1) // 2
