"""Test the median displacement over the area of a contact against exact truth."""

import numpy as np
import pytest

from fingerflow.kernels.library import is_present
from fingerflow.kernels.result_records import FrameEllipse
from fingerflow.tracker import displacement_medians as displacements
from fingerflow.tracker.displacement_medians import displacement_medians

REACH = 0.8


def contact(frames: int = 1, first: float = 7.0, second: float = 5.0, angle: float = 0.4) -> FrameEllipse:
    return FrameEllipse(
        np.tile([3.0, -2.0], (frames, 1)), np.tile([first, second], (frames, 1)), np.full(frames, angle)
    )


def crowded(count: int, draw: np.random.Generator) -> np.ndarray:
    """Return points (n, 2) in a contact, four times as dense where x is large, as where skin has texture."""
    points = draw.uniform(-5, 11, (40 * count, 2)) - [0, 5]
    dense = draw.uniform(size=len(points)) < np.where(points[:, 0] > 3, 1.0, 0.25)
    return points[dense & (contact().inside(points[None])[0] > 0)][:count]


def test_an_odd_field_has_the_value_at_the_centre_however_points_crowd() -> None:
    position = crowded(500, np.random.default_rng(1))[None]
    displacement = 0.02 * (position - [3.0, -2.0]) + [0.1, -0.05]
    median, _ = displacement_medians(position, displacement, np.zeros(position.shape[:2]), contact(), REACH)
    assert np.abs(np.median(displacement[0], axis=0) - [0.1, -0.05]).max() > 0.02
    # Points are 0.8 mm apart where they are few: the line of the median is known to a quarter of that.
    np.testing.assert_allclose(median[0], [0.1, -0.05], atol=0.02 * 0.8 / 2)


def test_the_deviation_covers_the_error() -> None:
    """Odd fields, borders off by 0.06 mm, points anywhere, noise of 10 um: 68 % of errors within a deviation, to the
    chance of 150 draws.
    """
    draw, z = np.random.default_rng(2), []
    for _ in range(150):
        position = crowded(int(draw.integers(300, 600)), draw)[None]
        off = position[0] - [3.0, -2.0]
        field = off[:, 0] * 0.01 if draw.integers(2) else np.tanh(off[:, 1]) * 0.03
        displacement = np.stack((field, field), axis=-1)[None] + 0.01 * draw.standard_normal((1, len(off), 2))
        size = 0.06 * draw.standard_normal()
        seen = contact(first=7 + size, second=5 + size)
        median, deviation = displacement_medians(position, displacement, np.full((1, len(off)), 1e-4), seen, REACH)
        z.append(median[0] / deviation[0])
    assert 0.6 < np.sqrt(np.square(z).mean()) < 1.2
    assert 0.62 < (np.abs(z) < 1).mean() < 0.9


@pytest.mark.parametrize("missing", ["contact", "points", "half of the area", "displacement"])
def test_what_is_not_known_is_nan(missing: str) -> None:
    position = crowded(400, np.random.default_rng(3))[None]
    displacement, ellipse = np.full(position.shape, 0.1), contact()
    if missing == "contact":
        ellipse = FrameEllipse(*(np.full_like(values, np.nan) for values in ellipse))
    elif missing == "points":
        position, displacement = position[:, :2], displacement[:, :2]
    elif missing == "half of the area":
        displacement[position[..., 0] < 3] = np.nan
    else:
        displacement[:] = np.nan
    for values in displacement_medians(position, displacement, np.zeros(position.shape[:2]), ellipse, REACH):
        assert np.isnan(values).all()


@pytest.mark.skipif(not is_present(), reason="the compiled library was not built or is turned off")
@pytest.mark.parametrize("points", [0, 1, 40, 700])
def test_the_compiled_library_gives_the_same(points: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some points coincide, are lost, or lie outside the ellipse; one contact is elsewhere, one has no size."""
    draw = np.random.default_rng(points)
    position, center, axes = (
        12 * draw.random((9, points, 2)),
        6 + draw.random((9, 2)) / 2,
        0.5 + 5 * draw.random((9, 2)),
    )
    position[:, ::7] = position[:, :1]
    displacement = 0.01 * position[:, :, ::-1] + draw.random((9, points, 2))
    displacement[draw.random((9, points)) < 0.1] = np.nan
    center[0, 0], axes[1, 0] = 1000.0, np.nan
    given = position, displacement, draw.random((9, points)), FrameEllipse(center, axes, 6 * draw.random(9)), 1.0
    compiled = displacement_medians(*given)
    monkeypatch.setattr(displacements, "is_present", lambda: False)
    np.testing.assert_allclose(compiled, displacement_medians(*given), rtol=1e-9, atol=1e-12)
    assert points < 700 or np.isfinite(compiled).any()
