"""Detection of the scale ring's hole: a dark disc whose size is known in millimetres."""

from numpy.typing import ArrayLike

from fingerflow.calibration.discs import find_dark_discs
from fingerflow.calibration.edge import Disc
from fingerflow.errors import FingerflowError

# Range of radii searched, as shares of the shorter side of the view. The lab's ring has 0.156.
HOLE_RADII = (0.05, 0.45)


def find_hole(view_image: ArrayLike, background: ArrayLike | None = None) -> Disc:
    """Return the hole of a flat ring in a view (H, W): the most significant large dark disc.

    Its `axis_ratio` shows how obliquely the ring is imaged; its `radius_px` is that of the circle of equal area.
    Raises FingerflowError if there is none; for `background` and other errors see `find_discs`.
    """
    holes = find_dark_discs(view_image, background, HOLE_RADII)
    if not holes:
        raise FingerflowError(
            f"no hole of a ring was found: a dark disc on a brighter ring, all of it inside the view, its radius "
            f"{HOLE_RADII[0]} to {HOLE_RADII[1]} of its shorter side. Check the frame and the pixel ranges of the view"
        )
    return holes[0]
