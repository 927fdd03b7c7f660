"""The frames in which a gel is at rest, from where its markers are in each."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

_LOOKS = 128  # frames that are compared with one another
_STILL = 0.02  # spacings that markers at rest may differ by
_MOST_OFF = 0.95  # of the markers do not
_FEWEST_SHARE = 0.1  # of the frames that are compared: fewer are no state in which the gel stays
_INNER = 0.3  # spacings between a marker and the middle of its four neighbours, below which it has them on all sides
_FLATTER = 0.8  # of the unevenness of the state that most frames show

Points = NDArray[np.float64]


class Rest(NamedTuple):
    """A frame at rest, and which frames (F,) look like it."""

    frame: int
    alike: NDArray[np.bool_]


def find_rest(frames: list[Points]) -> Rest:
    """The state in which the gel is at rest, of the places (M, 2) px of the markers in every frame.

    States are sets of frames whose markers are in the same places, to a fiftieth of their spacing; those in which the
    gel stays for a tenth of the recording are compared. Rest is the one that most frames show, unless another one is
    clearly more even: an object that is held bends a lattice. Evenness is the mean distance of markers from the middle
    of their four nearest neighbours. Where none lasts, as in a recording that never rests, it is the largest there is.
    """
    spacing = _spacing(frames)
    looks = np.unique(np.linspace(0, len(frames) - 1, min(len(frames), _LOOKS)).round().astype(int))
    trees = {int(k): cKDTree(frames[k]) for k in looks if len(frames[k])}
    alike = np.array([[_alike(trees.get(int(a)), frames[b], spacing) for b in looks] for a in looks])
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
    return Rest(frame, np.array([_alike(trees[frame], points, spacing) for points in frames]))


def _spacing(frames: list[Points]) -> float:
    nearest = [cKDTree(points).query(points, k=2)[0][:, 1] for points in frames if len(points) > 1]
    return float(np.median(np.concatenate(nearest))) if nearest else 1.0


def _alike(tree: cKDTree | None, points: Points, spacing: float) -> bool:
    """Whether the markers are where those of another frame are, and as many."""
    if tree is None or not len(points) or abs(len(points) - tree.n) > (1 - _MOST_OFF) * max(len(points), tree.n):
        return False
    return bool(np.mean(tree.query(points)[0] < _STILL * spacing) >= _MOST_OFF)


def _unevenness(points: Points, spacing: float) -> float:
    """Mean distance, px, of markers from the middle of their four nearest neighbours."""
    if len(points) < 5:
        return 0.0
    number = cKDTree(points).query(points, k=5)[1][:, 1:]
    off = np.linalg.norm(points[number].mean(1) - points, axis=-1)
    inner = off < _INNER * spacing
    return float(off[inner].mean()) if inner.any() else 0.0
