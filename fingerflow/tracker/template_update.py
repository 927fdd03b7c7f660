"""When templates are updated for the deformation of the skin."""

import math

MOST_FRAMES = 8  # from one check to the next, where skin is slow
FASTEST_PX = 0.2  # that the edges of windows may change by until then


def update_interval(fastest: float) -> int:
    """Frames to the next check of templates: a power of 2, in which edges of windows that change by `fastest` px a
    frame change by `FASTEST_PX` at most.
    """
    return 1 << int(math.log2(min(max(FASTEST_PX / max(fastest, 1e-9), 1), MOST_FRAMES)))
