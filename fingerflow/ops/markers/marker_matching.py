"""Matching of detected markers to the markers at rest, on the assumption that the gel moves continuously."""

from typing import NamedTuple

import torch
from torch import Tensor

_LABELS = 12  # number of candidates of a marker: the detections nearest to its expected position
_REACH = 1.3  # spacings, largest distance of a candidate from the expected position
_NEIGHBOURS = 8  # number of nearest neighbours to which a marker is tied; ties hold in both directions
_RADIUS = 1.6  # spacings, largest length of a tie: it includes the diagonal neighbours of a square lattice
_ROUNDS = 40
_DAMPING = 0.3
# Costs of an assignment, in the unit of (difference of two neighbours' displacements / their distance)^2. This ratio is
# 0.5 in a strongly sheared gel and 1 where a marker is mistaken for its neighbour.
_TORN = 0.5  # largest cost of a tie
_APART = 0.15  # cost of a tie to a marker that is not seen
_LOST = 0.6  # cost of a marker that is not seen
_INERTIA = 0.15  # cost of a distance of one spacing from the expected position
_NEVER = 1e6  # cost of an excluded assignment
_SETTLED = 1e-3  # largest change of a message at convergence


class Ties(NamedTuple):
    """Edges (ties) between neighbouring markers; each edge is listed in both directions.

    Attributes:
        first, second: (T,) int64, indices of the tied markers.
        back: (T,) int64, index of the tie in the opposite direction.
        distance: (T,) px between the two markers.
        spacing: px, of the markers.
    """

    first: Tensor
    second: Tensor
    back: Tensor
    distance: Tensor
    spacing: float


def tie_neighbours(reference: Tensor) -> Ties:
    """Return the edges between neighbouring markers, given the positions (N, 2) of the markers at rest.

    N is at least 2, and all positions are finite. The spacing is the median distance to the nearest neighbour.
    """
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
    """Match detected markers to markers at rest: return, for each marker at rest, the index (N,) of its detection among
    those `found` in a frame, or -1 if it is not detected.

    No detection is assigned twice. The assignment minimises the cost of a Markov random field by min-sum belief
    propagation (Felzenszwalb & Huttenlocher 2006). A tie costs the squared difference of the neighbours' displacements
    since rest over their distance, truncated. A marker costs its squared distance from the expected position. Between
    frames a marker may thus move by more than half a spacing, where the nearest detection is the wrong one: the match
    is still correct if the motion is continuous and part of the gel moves less.

    Args:
        reference: (N, 2) px, markers at rest.
        ties: `tie_neighbours` of `reference`.
        expected: (N, 2) px, expected positions in this frame.
        found: (M, 2) px, detections, finite.
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
    # Two markers cannot be the same detection, so this has the cost of an excluded assignment.
    torn = torch.where(near.indices[ties.first][:, :, None] == near.indices[ties.second][:, None], _NEVER, torn)
    # (T, labels of the first marker, labels of the second).
    cost = torch.nn.functional.pad(torn, (0, 1, 0, 1), value=_APART)
    message = torch.zeros_like(cost[:, 0])  # (T, labels + 1), message from the first marker of a tie to the second
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
    # Of two markers that claim one detection, the one with the larger margin over "not seen" keeps it.
    margin = belief[:, -1] - belief.amin(1)
    taken = torch.full((len(found),), -torch.inf, dtype=margin.dtype, device=margin.device)
    taken = taken.scatter_reduce(0, number[seen], margin[seen], "amax")
    claims = seen & (margin >= taken[number])
    # Of two markers with equal margins, the first keeps the detection.
    order = torch.arange(count, device=number.device)
    first = torch.full_like(taken, count, dtype=torch.int64).scatter_reduce(0, number[claims], order[claims], "amin")
    return torch.where(claims & (order == first[number]), number, nobody)
