"""Faint rim of the contact: by how much its border may lie further out where ridges are pale there."""

import math
from collections.abc import Iterator

from fingerflow.engines.engine import Engine, FrameContact, GlassLight, Images
from fingerflow.tracker.sizes_on_glass import SizesOnGlass

#: Share of the contact threshold at which a pale rim shows, and least width of a faint rim, mm, that is reported; of
#: clean prints up to 0.07.
FAINT, RIM_MM = 0.4, 0.1
# At this share the border lies further out, by 0.024 +- 0.009 mm on clean prints; light that varies over the view moves
# it further than the largest distance. Of a pale rim, `_UNSEEN` times what exceeds the usual distance was missing on
# prints.
_USUAL_MM, _FURTHEST_MM, _UNSEEN = 0.028, 0.5, 1.6


def pale_rim(
    engine: Engine, image: Images, light: GlassLight, contact: FrameContact, on_glass: SizesOnGlass
) -> tuple[float, float]:
    """Return the gross area, mm^2, of the `contact` in the contact view `image` with most contact, and by how much, mm,
    its border may lie further out as ridges are pale at its rim, by the contact at `FAINT` of the threshold.
    """
    lower = engine.contact(image, light, FAINT * contact.threshold)
    gross, whole = (float(on_glass.sizes(seen).gross[0]) for seen in (contact, lower))
    width = math.sqrt(whole / math.pi) - math.sqrt(gross / math.pi)
    return gross, _UNSEEN * max(width - _USUAL_MM, 0.0) if width < _FURTHEST_MM else 0.0


def check_faint_rim(width_mm: float, gross: float, threshold: float, radius_px: int, period_px: float) -> Iterator[str]:
    """Yield a warning if the rim of the contact is faint, so that its border may lie `width_mm` further out; `gross`
    mm^2 is its area without that rim, which has gaps where `radius_px` is below half the distance between ridges,
    `period_px`; 0 if that is not known.
    """
    narrow = radius_px < period_px / 2
    if width_mm < (0.75 if narrow else 1) * RIM_MM:  # a small radius hides half of such a rim: 0.2 mm were 0.09
        return
    more = (1 + width_mm / math.sqrt(gross / math.pi)) ** 2 - 1
    half = f" set [contact] gross_radius_px ({radius_px}) to half the ridge distance, {math.ceil(period_px / 2)},"
    yield (
        f"the contact is faint at its rim: its border may lie {width_mm:.2f} mm further out. Areas, ellipse, onsets "
        f"and what counts from them are those of the part inside; the gross area may be {more:.0%} larger. Set "
        f"[contact] threshold to {FAINT * threshold:.2f} if ridges are pale there,{half if narrow else ''} clean the "
        f"glass, or press harder"
    )
