"""Which of the markers that a picture shows is which: their motion is continuous, as that of the gel they are on."""

from typing import NamedTuple

import torch
from torch import Tensor

_LABELS = 12  # markers that one may be, the nearest to where it is expected
_REACH = 1.3  # spacings from there
_NEIGHBOURS = 8  # to which a marker is tied
_RADIUS = 1.6  # spacings: the diagonal neighbours of a square lattice are among them
_ROUNDS = 40
_DAMPING = 0.3
# Costs, in squares of the difference of two neighbours' displacements over their distance. Markers of a gel that is
# sheared hard differ by 0.5, and by 1 where one is taken for the next.
_TORN = 0.5  # beyond which a tie says nothing more
_APART = 0.15  # of a tie to a marker that is not seen
_LOST = 0.6  # of not being seen
_INERTIA = 0.15  # of a displacement by one spacing since the frame before
_NEVER = 1e6
_SETTLED = 1e-3


class Ties(NamedTuple):
    """Neighbours that are tied, `first`, `second` (T,), each pair in both directions, `back` (T,) the other direction;
    their `distance` (T,) px, and the `spacing` of the markers, px.
    """

    first: Tensor
    second: Tensor
    back: Tensor
    distance: Tensor
    spacing: float


def tie_neighbours(reference: Tensor) -> Ties:
    """Ties of markers (N, 2) at rest, N at least 2, all finite; the spacing is the median distance to the nearest."""
    distance = torch.cdist(reference, reference)
    distance.fill_diagonal_(torch.inf)
    spacing = float(distance.amin(1).median())
    nearest = distance.topk(min(_NEIGHBOURS, len(reference) - 1), dim=1, largest=False)
    near = torch.zeros_like(distance, dtype=torch.bool).scatter(1, nearest.indices, nearest.values < _RADIUS * spacing)
    near[torch.arange(len(near)), nearest.indices[:, 0]] = True
    first, second = (near | near.T).nonzero().unbind(1)
    number = torch.full_like(distance, -1, dtype=torch.int64)
    number[first, second] = torch.arange(len(first), device=reference.device)
    return Ties(first, second, number[second, first], distance[first, second], spacing)


def match_markers(reference: Tensor, ties: Ties, expected: Tensor, found: Tensor) -> Tensor:
    """Number (N,) of the marker that each one is among those found (M, 2), -1 where it is not seen; none is two.

    The labelling of least cost of a Markov random field: neighbours' displacements since rest differ by little against
    their distance, truncated, and nobody jumps without need; by min-sum belief propagation (Felzenszwalb &
    Huttenlocher 2006). So a motion of more than half a spacing from one frame to the next, where the nearest marker is
    the wrong one, is still read right as long as it is continuous and a part of the gel moves less.

    Args:
        reference: (N, 2) px at rest.
        ties: of them.
        expected: (N, 2) px, where each is expected now.
        found: (M, 2) px, finite.
    """
    count, labels = len(reference), min(_LABELS, len(found))
    nobody = torch.full((count,), -1, dtype=torch.int64, device=reference.device)
    if labels == 0:
        return nobody
    near = torch.cdist(expected, found).topk(labels, dim=1, largest=False)
    reachable = near.values <= _REACH * ties.spacing
    own = torch.where(reachable, _INERTIA * (near.values / ties.spacing).square(), _NEVER)
    own = torch.cat((own, torch.full_like(own[:, :1], _LOST)), dim=1)
    displacement = found[near.indices] - reference[:, None]
    change = displacement[ties.first][:, :, None] - displacement[ties.second][:, None]
    torn = (change.square().sum(-1) / ties.distance[:, None, None].square()).clamp_max(_TORN)
    # One marker is not two.
    torn = torch.where(near.indices[ties.first][:, :, None] == near.indices[ties.second][:, None], _NEVER, torn)
    cost = torch.nn.functional.pad(torn, (0, 1, 0, 1), value=_APART)  # (T, of the first, of the second)
    message = torch.zeros_like(cost[:, 0])  # (T, labels + 1), to the second from the first
    for _ in range(_ROUNDS):
        belief = own.index_add(0, ties.second, message)
        told = (belief[ties.first] - message[ties.back])[:, :, None] + cost
        best = told.amin(1)
        before, message = message, _DAMPING * message + (1 - _DAMPING) * (best - best.amin(1, keepdim=True))
        if float((message - before).abs().amax()) < _SETTLED:
            break
    belief = own.index_add(0, ties.second, message)
    chosen = belief.argmin(1)
    seen = chosen < labels
    number = near.indices.gather(1, chosen.clamp_max(labels - 1)[:, None])[:, 0]
    # Of two that claim one marker, the surer keeps it.
    margin = belief[:, -1] - belief.amin(1)
    taken = torch.full((len(found),), -torch.inf, dtype=margin.dtype, device=margin.device)
    taken = taken.scatter_reduce(0, number[seen], margin[seen], "amax")
    return torch.where(seen & (margin >= taken[number]), number, nobody)
