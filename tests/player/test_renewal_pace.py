"""How often templates are looked at in a stream."""

import numpy as np
import pytest

from fingerflow.player.contract.pace import FASTEST_PX, MOST_FRAMES
from fingerflow.player.renewal import Pace

WINDOW = 25
AT_EDGE = FASTEST_PX / (WINDOW // 2)  # of a component of the deformation


@pytest.mark.parametrize(("a_frame", "frames"), [(0.0, 8), (0.1, 8), (0.15, 4), (0.3, 2), (0.9, 1), (5.0, 1)])
def test_fast_skin_is_looked_at_sooner(a_frame: float, frames: int) -> None:
    """At most the frames in which the edge of a window changes by `FASTEST_PX`, a power of two, as in `process`; one
    point in twenty may be faster, or lost."""
    pace, warp = Pace(WINDOW), np.broadcast_to(np.eye(2), (1, 100, 2, 2)).copy()
    pace.see(1, 7, warp)
    assert pace.frames == MOST_FRAMES
    warp[:, :, 0, 1] += 4 * a_frame * AT_EDGE
    warp[:, 0] = np.nan
    warp[:, 1:4] += 100
    pace.see(1, 11, warp)
    assert pace.frames == frames
    pace.see(2, 12, np.broadcast_to(3 * np.eye(2), warp.shape))  # since another key frame: no change is known
    assert pace.frames == MOST_FRAMES
