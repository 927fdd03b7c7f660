"""Trend ("course") of a flow; the smoothness term penalises the departure from it."""

from torch import Tensor

from fingerflow.ops.flow.flow_cells import (
    halved,
    integrated,
    magnified,
    moments,
    places,
    plane_of,
    planes,
    window,
)

WINDOW = window(9)  # cells of 4 px


def course(flow: Tensor, known: Tensor) -> Tensor:
    """Return the trend (B, 2, h, w) of a flow on cells, of which some are known (B, 1, h, w), 1 or 0.

    It is the best-fitting plane, plus planes fitted to the remainder around every position, in two successive boxes of
    36 px.
    """
    whole = plane_of(flow, known).at(*places(flow))
    share = halved(known)
    x, y = places(share)
    around = planes(integrated(moments(share, halved(known * (flow - whole)), x, y), WINDOW))
    return whole + magnified(around.at(x, y), 2)[..., : flow.shape[-2], : flow.shape[-1]]
