"""Update interval of templates, by the speed at which the skin deforms."""

import math

MOST_FRAMES = 8  # longest update interval, for slow skin
FASTEST_PX = 0.2  # by which the edges of windows may shift within an interval


def update_interval(fastest: float) -> int:
    """Return the update interval: the frames to the next check of templates, a power of 2 from 1 to `MOST_FRAMES`.

    Within it, window edges that shift by `fastest` px a frame shift by `FASTEST_PX` at most, if 1 frame allows it.
    """
    return 1 << int(math.log2(min(max(FASTEST_PX / max(fastest, 1e-9), 1), MOST_FRAMES)))
