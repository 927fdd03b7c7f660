"""Self-test of an engine: results for a built-in frame are compared with stored results, or with those of another one.

An engine with other results computes wrongly on this computer. Every method of an engine whose results reach a record
is called, with inputs that do not depend on the results of other methods where this is possible.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from fingerflow.engines.contact_view import covers, glass_light
from fingerflow.engines.engine import Array, Corrected, Engine, EnteredPoints, FrameEllipse, TrackedPoints
from fingerflow.errors import FingerflowError
from fingerflow.kernels.arrays import identities
from fingerflow.kernels.tracking_limits import TrackStatus

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
_SEMI_AXES = np.array([0.36, 0.3])  # of the contact, in widths and heights of the view
_UNKNOWN = 7  # every 7th point has the position NaN, as a lost point has
_FEW, _MOST_FEW = 3, 16  # every 3rd point, at most 16, is among `BuiltIn.few`
_SIZE, _MOTIONS = ("height", "width", "bit_depth", "points"), ("numbers", "reversed")  # names in bundle.json
_DIGITS = 8  # significant digits of the numbers in bundle.json
_FLIPS = 0.01  # largest share of the values that may be finite in one of both results and NaN in the other
_DARKER = 0.9  # light of the empty glass of the reversed motion, and of its frame relative to this glass
# Displacements for fields: points move this many times as far as they do, so that rounding is a smaller share.
_LARGER = 5.0
_AWAY = np.float32(3.0)  # px along x and y, by which an outlier is put off its place
_ROUGH = np.float32(0.5)  # px along x and y, by which points are put off their places in turns
_CERTAIN, _UNCERTAIN = np.float32(0.02), np.float32(0.5)  # px, deviations of positions


_RELATIVE = "of itself"  # unit of a share of the value
_PX, _SHARE, _STRAIN = (1e-3, "px"), (1e-3, _RELATIVE), (5e-5, "m/m")
#: Largest differences to the expected results that rounding explains, with their units. Positions of engines differ by
#: up to 2e-5 px; 1e-3 px is guaranteed. A cell at the border may be in contact for one engine only.
TOLERANCES = {
    **dict.fromkeys(("real_area_px", "gross_area_px", "noise"), _SHARE),
    **dict.fromkeys(("center", "semi_axes"), (0.1, "px")),
    "axis": (0.01, ""),  # cosine and sine of twice the angle, of which pi more is the same axis
    **dict.fromkeys(("threshold", "illumination_gain"), (1e-3, "")),
    **dict.fromkeys(("covered", "off_neighbours", "uncertain"), (0.0, "")),
    **dict.fromkeys(("found", "found_alone", "found_updated", "corrected"), _PX),
    # The frame has no noise: the residual, on which the deviation is based, is a difference of nearly equal sums. Of
    # deviations of 7e-4 to 8e-3 px, 4e-5 px differ by the order of sums.
    "deviation": (2e-4, "px"),
    "warp": (5e-4, "px/px"),
    "searched": (0.05, "px"),
    "windows": (0.1, "grey levels"),
    "seeded": (0.05, "of the points"),
    **dict.fromkeys(("fields", "fields_entered", "median", "median_entered", "fit"), _STRAIN),
    "known_share": (0.01, ""),
    **dict.fromkeys(("fields_std", "median_std", "fit_std"), (0.02, _RELATIVE)),
}


class BuiltIn(NamedTuple):
    """Built-in test frame: synthetic images (H, W) of both views, and N points to track.

    Attributes:
        empty, contact: contact view without and with contact.
        key, topography: topography view of a texture, and of the same texture shifted and stretched by one per cent.
        points: (N, 2) px in `key`, NaN for none.
        expected: (N, 2) px, predicted positions of the points in `topography`.
        few: (n,) indices of the points that are tracked alone, updated and searched for; every fourth of them is put
            off its place for the test of outliers, and the next one is uncertain.
    """

    empty: Array
    contact: Array
    key: Array
    topography: Array
    points: Array
    expected: Array
    few: Array

    @property
    def truth(self) -> Array:
        """Return the true positions (N, 2) px in `topography`."""
        return self.expected - np.float32(_BESIDE)

    def reversed(self) -> "BuiltIn":
        """Return the frame of the reversed motion, without contact and in darker light."""
        empty, contact = (np.round(light * self.empty).astype(self.empty.dtype) for light in (_DARKER, _DARKER**2))
        known = np.isfinite(self.points)
        start = np.where(known, self.truth, np.float32(np.nan))
        expected = np.where(known, self.points, self.truth) + np.float32(_BESIDE)
        return BuiltIn(empty, contact, self.topography, self.key, start, expected, self.few + 1)


# Largest difference of a result from the expected one in both motions, and the largest that rounding explains: result,
# difference, tolerance, unit.
Difference = dict[str, Any]


def check_engine(engine: Engine, expected: Mapping[str, Any]) -> list[Difference]:
    """Check that the results of an engine for the built-in frame, and for its reversed motion, agree with those stored
    in a bundle; return the differences.

    Args:
        engine: created for the views and the number of points of the bundle.
        expected: "expected" of bundle.json: height, width, bit_depth and points of the frame, and the results of both
            motions.

    Raises:
        FingerflowError: they differ by more than rounding explains, or `expected` is damaged.
    """
    try:
        size = {name: int(expected[name]) for name in _SIZE}
        of_bundle = [{name: np.array(expected[motion][name], np.float64) for name in TOLERANCES} for motion in _MOTIONS]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FingerflowError(
            f"bundle.json: the numbers of the built-in frame ('expected') are damaged ({error!r}); export it again"
        ) from None
    frame, largest = built_in(**size, window_px=engine.settings.window_px), dict.fromkeys(TOLERANCES, 0.0)
    for shown, stated in zip((frame, frame.reversed()), of_bundle, strict=True):
        numbers = numbers_of(engine, shown)
        for name, theirs in stated.items():
            worst, message = _difference(name, numbers[name], theirs)
            if worst > TOLERANCES[name][0]:
                raise FingerflowError(
                    f"engine {engine.described}: its numbers of the built-in frame are not the expected ones ({name} "
                    f"{message}), so that none of its numbers can be trusted here; choose another engine or another "
                    "provider"
                )
            largest[name] = max(largest[name], worst)
    return [
        {"result": name, "difference": worst, "tolerance": TOLERANCES[name][0], "unit": TOLERANCES[name][1]}
        for name, worst in largest.items()
    ]


def _difference(name: str, ours: Array, theirs: Array) -> tuple[float, str]:
    """Return by how much a result differs from the expected one, in the unit of its tolerance and in words."""
    most, unit = TOLERANCES[name]
    if name == "seeded" and theirs.shape[1:] == ours.shape[1:]:
        distance = np.abs(ours[:, None] - theirs).max(-1) if len(ours) and len(theirs) else np.ones((1, 1))
        count = sorted((len(ours), len(theirs)))
        worst = float(1 - np.mean(distance.min(1) < _BESIDE) * count[0] / count[1])
        return worst, f"differ for {worst:.0%} {unit}"
    valid = np.isfinite(ours), np.isfinite(theirs)
    if ours.shape != theirs.shape or np.mean(valid[0] != valid[1]) > _FLIPS:
        return math.inf, f"is known elsewhere, {valid[0].sum()} for {valid[1].sum()} times"
    distance = np.abs(ours - theirs) / (np.maximum(np.abs(theirs), 1e-6) if unit == _RELATIVE else 1)
    worst = float(np.max(distance[valid[0] & valid[1]], initial=0.0))
    return worst, f"is off by {worst:.2g} {unit}, where rounding explains {most:g}"


def expected_of(engine: Engine, height: int, width: int, bit_depth: int, points: int) -> dict[str, Any]:
    """Compute what a bundle states for `check_engine`, by an engine whose numbers are right: the sizes of the built-in
    frame, and the results of both motions as nested lists, with None for NaN, which JSON cannot represent.
    """
    size = dict(zip(_SIZE, (height, width, bit_depth, points), strict=True))
    frame = built_in(**size, window_px=engine.settings.window_px)
    both = (numbers_of(engine, shown) for shown in (frame, frame.reversed()))
    stated = ({name: _rounded(values) for name, values in numbers.items()} for numbers in both)
    return {**size, **dict(zip(_MOTIONS, stated, strict=True))}


def _rounded(values: Array) -> Any:
    if values.ndim:
        return [_rounded(one) for one in values]
    return float(f"{float(values):.{_DIGITS}g}") if np.isfinite(values) else None


def numbers_of(engine: Engine, frame: BuiltIn) -> dict[str, Array]:
    """Return the results that an engine computes for the built-in frame; their names are those of `TOLERANCES`."""
    parts = (part(engine, frame) for part in (_contact_numbers, _point_numbers, _field_numbers))
    return {name: np.asarray(value, np.float64) for part in parts for name, value in part.items()}


def _contact_numbers(engine: Engine, frame: BuiltIn) -> dict[str, Any]:
    light, images = glass_light(frame.empty, None), engine.images(frame.contact[None])
    contact = engine.contact(images, light, np.array([THRESHOLD], np.float32))
    names = "real_area_px", "gross_area_px", "center", "semi_axes", "illumination_gain"
    covered = covers(contact.density_margin, frame.expected[None], np.eye(2, 3), engine.cell_px)[0]
    return {
        **{name: getattr(contact, name)[0] for name in names},
        "axis": np.stack((np.cos(2 * contact.angle[0]), np.sin(2 * contact.angle[0]))),
        "threshold": engine.contact(images, light).threshold[0],
        "covered": np.where(covered, 1.0, np.nan),  # a point at the border may be known to one engine only
    }


def _point_numbers(engine: Engine, frame: BuiltIn) -> dict[str, Any]:
    count, few = len(frame.points), frame.few
    images = engine.images(frame.topography[None])
    templates = engine.prepare(engine.images(frame.key[None]), frame.points)
    still, straight = np.zeros_like(frame.expected), identities(count).copy()
    found = engine.track(templates, images, frame.expected, still).found

    def correct(points: TrackedPoints) -> Corrected:
        return engine.correct(frame.points, points, templates.numbers, straight)

    def judge(positions: Array, covariance: Array) -> Corrected:
        """Judge all points as tracked, at the given positions (N, 2) px."""
        status, positions = np.zeros_like(found.status), positions[None].astype(np.float32)
        return correct(found._replace(points=positions, covariance=covariance, status=status))

    corrected = correct(found)
    start, near = frame.points[few], frame.expected[few]
    alone = engine.track(templates, images, near, still[few], few).found.points[0]
    stretched = np.broadcast_to(_STRETCH.astype(np.float32), (len(few), 2, 2)).copy()
    templates.update(few, engine.prepare(templates, start, stretched))
    results = {
        "noise": templates.noise,
        "seeded": engine.detect(images, np.ones(frame.key.shape, bool), count),
        "found": found.points[0],
        "found_alone": alone,
        "found_updated": engine.track(templates, images, frame.expected, still).found.points[0],
        "corrected": corrected.found.points[0],
        "deviation": np.sqrt(corrected.found.variance[0]),
        "windows": engine.windows(images, np.zeros(len(few), np.int64), near, stretched).mean(1),
    }
    positions = frame.truth.copy()
    positions[few[::4]] += _AWAY
    status = judge(positions, _covariance(frame)).found.status[0]
    results |= {"off_neighbours": status == TrackStatus.OFF_NEIGHBOURS, "uncertain": status == TrackStatus.UNCERTAIN}
    # In a rough field a local fit depends on its weights, which it does not in a uniform stretch; no point of it is an
    # outlier where all are uncertain.
    rough = frame.truth + _ROUGH * np.where(np.indices((count, 2))[0] // (1, 2) % 2, 1, -1)
    results["warp"] = judge(rough, straight[None]).warp[0]
    if engine.settings.search_px:
        positions, returns = engine.search(templates, images, start, near)
        results["searched"] = np.where(returns[:, None], positions, np.nan)
    return results


def _covariance(frame: BuiltIn) -> Array:
    """Return the covariances (1, N, 2, 2) px^2 of positions, of which some are uncertain."""
    deviation = np.full((1, len(frame.points), 1, 1), _CERTAIN)
    deviation[:, frame.few[1::4]] = _UNCERTAIN
    return deviation**2 * np.eye(2, dtype=np.float32)


def _field_numbers(engine: Engine, frame: BuiltIn) -> dict[str, Any]:
    """Return fields, their medians, and gradients between points, from the true displacements of the points.

    The length unit is chosen so that some twenty points lie within the reach of a fit.
    """
    size, count = np.array(frame.key.shape[::-1], np.float32), len(frame.points)
    unit = np.float32(engine.settings.gauge_length_mm / 5 / math.sqrt(size.prod() / count))
    reference, moved = unit * frame.points, _LARGER * unit * (frame.truth - frame.points)[None]
    middle, semi_axes = unit * size / 2, unit * size * _SEMI_AXES
    ellipse = FrameEllipse(*(np.array([one], np.float32) for one in (middle, semi_axes, 0.1)))
    among = (np.arange(count) % 5 == 0)[None]
    gradient = np.where(among[..., None, None], np.nanstd(moved) * np.eye(2), np.nan).astype(np.float32)
    results: dict[str, Any] = {}
    for name, entered in (("", None), ("_entered", EnteredPoints(among, gradient, None))):
        fields = engine.fields(reference, moved, ellipse, None, entered)
        of_points = fields.divergence[..., None], fields.curl[..., None], fields.strain, fields.shear
        results[f"fields{name}"] = np.concatenate(of_points, axis=-1)[0]
        results[f"median{name}"] = fields.median[0]
        results["known_share"] = fields.known_share[0]
    valid, gauge = np.isfinite(frame.points[:, 0]), engine.settings.gauge_length_mm
    points = reference[valid], moved[:, valid], reference[valid] + unit, gauge
    covariance = unit**2 * _covariance(frame)
    spread: Any = engine.fit(*points, covariance[:, valid, 0, 0])[1]
    with_std: Any = engine.fields(reference, moved, ellipse, covariance)
    return results | {
        "fit": engine.fit(*points)[0][0],
        "fields_std": np.concatenate((with_std.divergence_std, with_std.curl_std)),
        "median_std": with_std.median_std[0],
        "fit_std": np.sqrt(np.einsum("qijij->qij", spread[0])),
    }


def built_in(height: int, width: int, bit_depth: int, points: int, window_px: int) -> BuiltIn:
    """Create the built-in test frame of a given size, with a given number of points."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    middle = np.array([width / 2, height / 2])
    along, across = (x - middle[0]) / (_SEMI_AXES[0] * width), (y - middle[1]) / (_SEMI_AXES[1] * height)
    ridges = np.where(np.sin(0.75 * x + 0.1 * y) > -0.2, _RIDGE, _VALLEY)
    places = np.stack((x, y), -1) - _SHIFT - middle
    material = places @ np.linalg.inv(_STRETCH).T + middle
    start = spread(height, width, points, window_px // 2 + _MARGIN)
    moved = (start - middle) @ _STRETCH.T + middle + _SHIFT + _BESIDE
    start[::_UNKNOWN] = np.nan

    def view(values: Array) -> Array:
        return np.round(values * ((2**bit_depth - 1) / 255)).astype(np.uint8 if bit_depth == 8 else np.uint16)

    return BuiltIn(
        view(np.full((height, width), _GLASS)),
        view(np.where(along**2 + across**2 < 1, ridges, _GLASS)),
        view(_texture(x, y)),
        view(_texture(material[..., 0], material[..., 1])),
        start.astype(np.float32),
        moved.astype(np.float32),
        np.arange(1, points - 1, _FEW)[:_MOST_FEW],
    )


def _texture(x: Array, y: Array) -> Array:
    """Return a texture in grey levels that repeats nowhere: a sum of waves 7 to 20 px long in all directions."""
    total = np.zeros_like(x)
    for wave in range(_WAVES):
        # Direction and wavelength by golden angle and golden ratio, so that no two waves are alike.
        turn, length = 2.399963 * wave, 7 + 13 * (0.618034 * wave % 1)
        total += np.sin(2 * math.pi / length * (math.cos(turn) * x + math.sin(turn) * y) + wave * wave)
    return np.clip(120 + 80 / math.sqrt(2 * _WAVES) * total, 0, 255)


def spread(height: int, width: int, count: int, margin: int = 0) -> Array:
    """Return points (count, 2) px spread evenly over a view, except for a margin at the border."""
    columns = math.ceil(math.sqrt(count * width / height))
    number, rows = np.arange(count), -(-count // columns)
    size = np.array([width, height])
    inside = np.minimum(margin, size // 2 - 1)
    share = (np.stack((number % columns, number // columns), -1) + 0.5) / (columns, rows)
    return inside + share * (size - 1 - 2 * inside)
