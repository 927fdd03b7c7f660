"""When templates are updated for the deformation of the skin."""

import math

MOST_FRAMES = 8  # from one check to the next, where skin is slow
FASTEST_PX = 0.2  # that the edges of windows may change by until then
# px that a deformation may shift the edge of a window before its template is updated. What leans, and what the residual
# owes to it, is taken off: on a press positions are as exact at 0.2 px, for half of the templates. But which templates
# exceed the limit turns on a digit, and then two engines differ by up to 0.009 px, not 3e-5 as here.
UPDATE_PX = 0.1


def update_interval(fastest: float) -> int:
    """Frames to the next check of templates: a power of 2, in which edges of windows that change by `fastest` px a
    frame change by `FASTEST_PX` at most.
    """
    return 1 << int(math.log2(min(max(FASTEST_PX / max(fastest, 1e-9), 1), MOST_FRAMES)))
