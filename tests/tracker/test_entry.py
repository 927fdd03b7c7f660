"""Tests of how points come into contact: by sliding over a border at rest, or by being covered by a contact
that grows.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from fingerflow.engines.engine import Engine, EngineSettings
from fingerflow.kernels.result_records import FrameEllipse
from fingerflow.recordings.lens import Geometry
from fingerflow.schema.scene_tables import CalibrationSettings
from fingerflow.tracker.entry import Entries, advected
from fingerflow.tracker.frame_results import FrameResults, Seeding

Row = tuple[float, ...]


@pytest.mark.parametrize(
    ("grows", "slides", "drifts", "expected"),
    [
        pytest.param(0.0, (0.3, 0.0), (0.0, 0.0), True, id="slides in over a border at rest"),
        pytest.param(0.3, (0.0, 0.0), (0.0, 0.0), False, id="at rest under a contact that grows"),
        pytest.param(0.3, (0.1, 0.0), (0.0, 0.0), False, id="border three times as fast"),
        pytest.param(0.1, (0.3, 0.0), (0.0, 0.0), True, id="skin three times as fast"),
        pytest.param(0.0, (0.01, 0.0), (0.0, 0.0), False, id="hardly moves"),
        pytest.param(0.05, (0.3, 0.0), (0.3, 0.0), True, id="a contact that grows as it carries skin along"),
    ],
)
def test_points_slide_into_contact_where_skin_moves_faster_than_the_border(
    grows: float, slides: Row, drifts: Row, expected: bool
) -> None:
    """Points slid into contact if the skin moves faster than the border, and were covered otherwise.

    The parameters are the motion of border and skin in 10 frames, mm, at the left of a tilted ellipse. The motion of
    neighbours alone called 0.2 mm of motion a slide, whatever the border did.
    """
    frames, tilt = np.arange(11), 0.4
    share = frames[:, None] / 10
    center = share * drifts
    border = FrameEllipse(
        center, np.stack((5 + grows * share[:, 0], 4 + grows * share[:, 0]), axis=-1), np.full(11, tilt)
    )
    rim = np.linspace(np.pi - 0.5, np.pi + 0.5, 12)
    turn = np.array([[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]])
    rows = [np.stack((scale * 5 * np.cos(rim), scale * 4 * np.sin(rim)), axis=-1) @ turn.T for scale in (0.97, 1.01)]
    places = np.concatenate([*rows, rows[1] - (0.05, 0.0)])
    position = places + share[:, None] * slides
    depth = border.inside(position)
    onset = np.where((depth > 0).any(0), (depth > 0).argmax(0), -1)
    if not (onset > 0).any():  # no point enters: they count as entered in the last frame
        onset[onset < 0] = 10
    reference = position[np.maximum(onset, 0), np.arange(len(places))]
    reference[onset < 0] = np.nan
    found = advected(position, places, onset, reference, 1.6, border)
    assert not found[onset <= 0].any()
    assert (onset > 0).sum() > 5
    assert (found[onset > 0] == expected).all()


def test_a_stream_finds_the_advected_points_of_a_recording(make_engine: Callable[[EngineSettings], Engine]) -> None:
    """Skin is dragged while a contact grows; a point is lost while the border passes it.

    A stream extended the mask in each frame, from points that it had itself added as neighbours: to 55 points too many.
    """
    axis, frames = np.arange(0, 6, 0.4), np.arange(30)[:, None]
    grid = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    border = FrameEllipse(np.full((30, 2), 3.0), (0.5 + 0.1 * frames).repeat(2, 1), np.zeros(30))
    position = grid + 0.06 * (frames[..., None] - 15)
    covered, lost = border.inside(position) > 0, 7 * len(axis) + 10
    begins = covered & np.diff(covered, axis=0, prepend=False)
    position[3:24, lost] = np.nan
    variance = 1e-6 + 0 * position[..., 0]
    entries, reference = Entries(make_engine(EngineSettings()), grid), np.full(grid.shape, np.nan)
    for k in range(30):
        reference[begins[k]] = position[k, begins[k]]
        frame = position[k], variance[k], covered[k], begins[k], covered[k], reference
        entries.update(*frame, border.select(slice(k, k + 1)))
        entries.learn_errors(0.0)
    assert covered[-1, lost]
    assert np.isfinite(entries.of_onset).all()
    # A recording has no reference of the lost point.
    differs = entries.entered != advected(position, grid, entries.onset, reference, 1.6, border)
    assert differs.nonzero()[0].tolist() == [lost]


def test_the_variance_of_inherited_displacements_adds_up(make_engine: Callable[[EngineSettings], Engine]) -> None:
    """Points are seeded five times on resting skin, whose displacement is a wave of 3 spacings: an error of
    interpolation comes in each time, and the variance holds them all, where the last alone was a twenty-fifth.
    """
    results = FrameResults(make_engine(EngineSettings()), Geometry(CalibrationSettings(mm_per_px=0.02), None, None))
    seeded = np.random.default_rng(1).uniform(0, 400, (6, 300, 2))
    covered, wave = np.ones(300, dtype=bool), 0.1 * np.sin(seeded * 2 * np.pi / 70)
    results._begin(Seeding(seeded[0], None), covered)
    results._touches.replace(np.arange(300), 0.02 * seeded[0] - wave[0])
    results._frames = 1
    for before, points in pairwise(seeded):
        results._begin(Seeding(points, before), covered)
    error = 0.02 * seeded[-1] - results._touches.position - wave[-1]
    assert 0.5 < np.square(error).mean() / results._inherited.mean() < 2
    results._begin(Seeding(seeded[0] + [600, 0], seeded[-1]), covered)  # 4 mm from all points that are known
    assert np.isnan(results._inherited).all()
