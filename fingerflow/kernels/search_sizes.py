"""Template and search sizes of the exhaustive search, which works on images of half resolution.

The search is `ops.tracking.search`.
"""

# Side of the template of a wide search in tracking windows. Ridges repeat every 15 px: a window of 21 px holds little
# more than one of them and matches the neighbouring ridge almost as well; 63 px hold the bends and endings by which
# ridges differ. A search within a few px needs no larger template, as there is no neighbouring ridge.
_WIDENING = 3
SEARCHED = 1.0  # accuracy of a search, px of the full image


def sizes_of(window: int, radius: int) -> tuple[int, int]:
    """Return the side (odd) of the template of an exhaustive search and the search radius, in px at half resolution,
    from the tracking window and the search radius at full resolution.

    `window` is the side of the tracking window and `radius` that of the search in x and y, px at full resolution.
    """
    return 2 * (min(_WIDENING * window, window + 2 * radius) // 4) + 1, (radius + 1) // 2
