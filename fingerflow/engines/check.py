"""Self-test of an engine: results for a built-in frame are compared with those stored in the bundle.

An engine with other results computes wrongly on this computer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from fingerflow.engines.engine import Array, Engine
from fingerflow.errors import FingerflowError

# Threshold of the relative intensity loss. It lies between those of two grey levels, even if the illumination gain is
# off by 0.5 %.
THRESHOLD = 0.4875
# Brightness, grey levels of 255: glass without contact, touching ridges, valleys between ridges.
_GLASS, _RIDGE, _VALLEY = 200.0, 40.0, 180.0
_WAVES = 24
_STRETCH = np.array([[1.01, 0.004], [-0.003, 0.995]])
_SHIFT = np.array([0.3, -0.2])
_BESIDE = 0.2  # px, error along x and y of the predicted positions
_MARGIN = 8  # px, distance of the tracking windows from the border of the view
_DIFFERENT = "its numbers of the built-in frame are not those of the bundle"
_UNKNOWN = 7  # every 7th point has the position NaN, as a lost point has
_FOUND = 0.8  # least share of the points whose measured position is nearer to the true than to the predicted one
# Frames computed, alternating between two images: more than an engine computes before it captures a CUDA graph.
_TURNS = 6
_FLIPS = 0.01  # largest share of the values that may be finite in one of both results and NaN in the other


class Tolerance(NamedTuple):
    """Tolerance of the self-test: the largest difference that rounding can cause, with its unit.

    If `relative`, it is a share of the value.
    """

    most: float
    unit: str
    relative: bool = False


#: Largest differences to the results stored in a bundle. Positions of engines differ by up to 2e-5 px; 1e-3 px is
#: guaranteed. A cell at the border may be in contact for one engine only.
TOLERANCES = {
    "real_area_px": Tolerance(1e-3, "of itself", relative=True),
    "gross_area_px": Tolerance(1e-3, "of itself", relative=True),
    "center": Tolerance(0.1, "px"),
    "semi_axes": Tolerance(0.1, "px"),
    "found": Tolerance(1e-3, "px"),
    "corrected": Tolerance(1e-3, "px"),
    # The frame has no noise: the residual, on which the deviation is based, is a difference of nearly equal sums.
    "deviation": Tolerance(0.05, "of itself", relative=True),
}


class BuiltIn(NamedTuple):
    """Built-in test frame: synthetic images (H, W) of both views, and N points to track.

    Attributes:
        empty, contact: contact view without and with contact.
        key, topography: topography view of a texture, and of the same texture shifted and stretched by one per cent.
        points: (N, 2) px in `key`, NaN for none.
        expected: (N, 2) px, predicted positions of the points in `topography`.
    """

    empty: Array
    contact: Array
    key: Array
    topography: Array
    points: Array
    expected: Array


def check_engine(engine: Engine, expected: Mapping[str, Any]) -> None:
    """Check that the results of an engine for the built-in frame agree with those stored in a bundle.

    Frames of other content must have other results (`check_frames`).

    Args:
        engine: created for the views and the number of points of the bundle.
        expected: "expected" of bundle.json: height, width, bit_depth and points of the frame, and its results.

    Raises:
        FingerflowError: they differ by more than rounding explains, or `expected` is damaged.
    """
    try:
        height, width, bit_depth, points = (int(expected[name]) for name in ("height", "width", "bit_depth", "points"))
        of_bundle = {name: np.array(expected["numbers"][name], np.float64) for name in TOLERANCES}
    except (KeyError, TypeError, ValueError) as error:
        raise FingerflowError(
            f"bundle.json: the numbers of the built-in frame ('expected') are damaged ({error!r}); export it again"
        ) from None
    frame = built_in(height, width, bit_depth, points, engine.settings.window_px)
    check_frames(engine, frame)
    for name, ours in numbers_of(engine, frame).items():
        theirs, tolerance = of_bundle[name], TOLERANCES[name]
        known = np.isfinite(ours), np.isfinite(theirs)
        if ours.shape != theirs.shape or np.mean(known[0] != known[1]) > _FLIPS:
            found = f"{name} is known elsewhere, {known[0].sum()} for {known[1].sum()} times"
            raise FingerflowError(_sentence(engine, f"{_DIFFERENT} ({found})"))
        apart, both = np.abs(ours - theirs), known[0] & known[1]
        if tolerance.relative:
            apart = apart / np.maximum(np.abs(theirs), 1e-6)
        worst = float(np.max(apart[both], initial=0.0))
        if not worst <= tolerance.most:
            found = f"{name} is off by {worst:.2g} {tolerance.unit}, where rounding explains {tolerance.most:g}"
            raise FingerflowError(_sentence(engine, f"{_DIFFERENT} ({found})"))


def check_frames(engine: Engine, frame: BuiltIn) -> None:
    """Check that an engine computes each frame anew: two built-in frames in turns have their own results every time.

    A recorded graph that reads the first frame for ever gives the same results for both.

    Raises:
        FingerflowError: a result is not that of its frame.
    """
    light = engine.light(frame.empty.astype(np.float32), None)
    templates = engine.prepare(engine.key(engine.images(frame.key[None])), frame.points)
    threshold, still = np.array([THRESHOLD], np.float32), np.zeros_like(frame.points)
    for turn in range(_TURNS):
        moved = turn % 2
        topography, expected, truth = (
            (frame.topography, frame.expected, frame.expected - np.float32(_BESIDE))
            if moved
            else (frame.key, frame.points, frame.points)
        )
        found = engine.follow(templates, engine.images(topography[None]), expected, still).found.points[0]
        contact = engine.contact(engine.images((frame.contact if moved else frame.empty)[None]), light, threshold)
        apart, area = np.abs(found - truth)[np.isfinite(frame.points[:, 0])], contact.real_area_px[0]
        if np.mean(apart < _BESIDE / 2) < _FOUND or (area > 0) != moved:
            raise FingerflowError(
                _sentence(
                    engine,
                    f"of two frames in turns one has results that are not its own: positions are off by "
                    f"{np.median(apart):.2g} px, and {area:.0f} px are in contact",
                )
            )


def _sentence(engine: Engine, found: str) -> str:
    return (
        f"engine {engine.described}: {found}, so that none of its numbers can be trusted here; choose another engine "
        "or another provider"
    )


def numbers_of(engine: Engine, frame: BuiltIn) -> dict[str, Array]:
    """Compute the results of an engine for the built-in frame, by the names in `TOLERANCES`."""
    light = engine.light(frame.empty.astype(np.float32), None)
    contact = engine.contact(engine.images(frame.contact[None]), light, np.array([THRESHOLD], np.float32))
    templates = engine.prepare(engine.key(engine.images(frame.key[None])), frame.points)
    nowhere = np.zeros_like(frame.expected)
    found = engine.follow(templates, engine.images(frame.topography[None]), frame.expected, nowhere).found
    straight = np.broadcast_to(np.eye(2, dtype=np.float32), (len(frame.points), 2, 2)).copy()
    corrected = engine.correct(frame.points, found, templates.numbers, straight).found
    return {
        **{name: getattr(contact, name)[0] for name in ("real_area_px", "gross_area_px", "center", "semi_axes")},
        "found": found.points[0],
        "corrected": corrected.points[0],
        "deviation": np.sqrt(corrected.variance[0]),
    }


def built_in(height: int, width: int, bit_depth: int, points: int, window_px: int) -> BuiltIn:
    """Create the built-in test frame of a given size, with a given number of points."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    middle = np.array([width / 2, height / 2])
    along, across = (x - middle[0]) / (0.36 * width), (y - middle[1]) / (0.3 * height)
    ridges = np.where(np.sin(0.75 * x + 0.1 * y) > -0.2, _RIDGE, _VALLEY)
    places = np.stack((x, y), -1) - _SHIFT - middle
    material = places @ np.linalg.inv(_STRETCH).T + middle
    start = spread(height, width, points, window_px // 2 + _MARGIN)
    moved = (start - middle) @ _STRETCH.T + middle + _SHIFT + _BESIDE
    start[::_UNKNOWN] = np.nan

    def view(values: Array) -> Array:
        levels: Array = np.round(values * ((2**bit_depth - 1) / 255)).astype(np.uint8 if bit_depth == 8 else np.uint16)
        return levels

    return BuiltIn(
        view(np.full((height, width), _GLASS)),
        view(np.where(along**2 + across**2 < 1, ridges, _GLASS)),
        view(_texture(x, y)),
        view(_texture(material[..., 0], material[..., 1])),
        start.astype(np.float32),
        moved.astype(np.float32),
    )


def _texture(x: Array, y: Array) -> Array:
    """Return a texture in grey levels that repeats nowhere: a sum of waves 7 to 20 px long in all directions."""
    total = np.zeros_like(x)
    for wave in range(_WAVES):
        # Direction and wavelength by golden angle and golden ratio, so that no two waves are alike.
        turn, length = 2.399963 * wave, 7 + 13 * (0.618034 * wave % 1)
        total += np.sin(2 * math.pi / length * (math.cos(turn) * x + math.sin(turn) * y) + wave * wave)
    levels: Array = 120 + 80 / math.sqrt(2 * _WAVES) * total
    return np.clip(levels, 0, 255)


def spread(height: int, width: int, count: int, margin: int = 0) -> Array:
    """Return points (count, 2) px spread evenly over a view, except for a margin at the border."""
    columns = math.ceil(math.sqrt(count * width / height))
    number, rows = np.arange(count), -(-count // columns)
    places = []
    for size, place in ((width, (number % columns + 0.5) / columns), (height, (number // columns + 0.5) / rows)):
        inside = min(margin, size // 2 - 1)
        places.append(inside + place * (size - 1 - 2 * inside))
    return np.stack(places, -1)
