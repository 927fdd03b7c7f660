"""How often templates are looked at again, in a recording and in a stream."""

import math

MOST_FRAMES = 8  # from one look to the next, where skin is slow
FASTEST_PX = 0.2  # that the edges of windows may change by until then


def frames_to_next_look(fastest: float) -> int:
    """A power of 2: as many frames as edges of windows, which change by ``fastest`` px a frame, may change in."""
    return 1 << int(math.log2(min(max(FASTEST_PX / max(fastest, 1e-9), 1), MOST_FRAMES)))
