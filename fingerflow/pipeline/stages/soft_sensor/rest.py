"""Detection of the frames in which the gel of a soft sensor is at rest, from the marker positions."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

_LOOKS = 128  # number of sampled frames, all compared with one another
_STILL = 0.02  # spacings, largest distance of corresponding markers in frames of one state
_MOST_OFF = 0.95  # least share of the markers that must correspond
_FEWEST_SHARE = 0.1  # least share of the sampled frames in a state; a state with fewer does not last
_INNER = 0.3  # spacings, largest distance of a marker from the centroid of its four neighbours that surround it
# Ratio of its unevenness to that of the most frequent state, below which another state is taken for rest.
_FLATTER = 0.8

Points = NDArray[np.float64]


class Rest(NamedTuple):
    """Frame in which a gel is at rest, and mask (F,) of all frames in which the markers lie at rest positions."""

    frame: int
    alike: NDArray[np.bool_]


def find_rest(frames: list[Points]) -> Rest:
    """Find a frame in which the gel is at rest, from the marker positions (M, 2) px in every frame.

    States are sets of frames whose markers have the same positions, to a fiftieth of their spacing. Rest is the most
    frequent state, unless another one that lasts for a tenth of the recording is clearly more even: an object that is
    held bends the lattice. Evenness is measured by the mean distance of markers from the centroid of their four nearest
    neighbours.
    """
    spacing = _spacing(frames)
    looks = np.unique(np.linspace(0, len(frames) - 1, min(len(frames), _LOOKS)).round().astype(int))
    trees = {int(k): cKDTree(frames[k]) for k in looks if len(frames[k])}
    alike = np.array([[_show_same_state(trees.get(int(a)), frames[b], spacing) for b in looks] for a in looks])
    free, states = np.ones(len(looks), dtype=bool), list[int]()
    while free.any():
        count = (alike & free).sum(1) * free
        middle = int(np.argmax(count))
        if count[middle] == 0 or (states and count[middle] < _FEWEST_SHARE * len(looks)):
            break
        states.append(middle)
        free &= ~alike[middle]
        free[middle] = False
    if not states:
        return Rest(0, np.arange(len(frames)) == 0)
    chosen, usual = states[0], _unevenness(frames[looks[states[0]]], spacing)
    for other in states[1:]:
        found = _unevenness(frames[looks[other]], spacing)
        if found < _FLATTER * usual:
            chosen, usual = other, found
    frame = int(looks[chosen])
    return Rest(frame, np.array([_show_same_state(trees[frame], points, spacing) for points in frames]))


def _spacing(frames: list[Points]) -> float:
    nearest = [cKDTree(points).query(points, k=2)[0][:, 1] for points in frames if len(points) > 1]
    return float(np.median(np.concatenate(nearest))) if nearest else 1.0


def _show_same_state(tree: cKDTree | None, points: Points, spacing: float) -> bool:
    """Return whether two frames show the gel in one state: marker counts within 5 %, most at equal positions."""
    if tree is None or not len(points) or abs(len(points) - tree.n) > (1 - _MOST_OFF) * max(len(points), tree.n):
        return False
    return bool(np.mean(tree.query(points)[0] < _STILL * spacing) >= _MOST_OFF)


def _unevenness(points: Points, spacing: float) -> float:
    """Return how irregular a marker lattice is: mean distance, px, of markers from the centroid of their four
    neighbours.
    """
    if len(points) < 5:
        return 0.0
    number = cKDTree(points).query(points, k=5)[1][:, 1:]
    off = np.linalg.norm(points[number].mean(1) - points, axis=-1)
    inner = off < _INNER * spacing
    return float(off[inner].mean()) if inner.any() else 0.0
