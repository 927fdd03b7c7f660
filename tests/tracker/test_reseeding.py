"""Tests of when a stream measures its threshold, takes a new key frame and seeds points again, from its frames
alone.
"""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fingerflow.pipeline.stages.contact.contact_stage import ContactStage
from fingerflow.recordings.lens import Geometry
from fingerflow.schema.scene_tables import CalibrationSettings
from fingerflow.schema.views import Rectangle
from fingerflow.tracker.reseeding import CONTACT, ReseedingSchedule, ThresholdSearch


def test_a_growing_contact_measures_the_threshold_again() -> None:
    """The threshold is measured two frames after a contact has grown by a fourth since the last threshold came into
    use, and again after each further fourth.
    """
    search = ThresholdSearch(2)
    used, measured = {}, []
    for index in range(40):
        threshold = search.due(index)
        if threshold is not None:
            search.used()
            used[index] = threshold
        if search.wants(index):
            measured.append(index)
        area = max(0.0, index - 5)
        search.update(index, area, (0.2 + index / 100 if area else math.nan) if index in measured else None)
    # A threshold applies from frame 10 on, with an area of 5. The area exceeds 6.25 in frame 12: the threshold is
    # measured in frame 14 and applies from frame 16 on.
    assert measured[:6] == [0, 4, 8, 14, 21, 30]
    assert dict([*used.items()][:3]) == pytest.approx({10: 0.28, 16: 0.34, 23: 0.41})


def test_single_frames_change_nothing() -> None:
    """Single frames with few points change nothing, nor do frames that are not four in a row. Lost points are seeded
    again after 64 frames at the earliest.
    """
    upkeep = ReseedingSchedule(0.8, math.inf)
    upkeep.restarted(0, 0, 100)
    tracked = [100, 10, 100, 10, 10, 10, 100, 70, 70, 70, 100]
    assert [upkeep.update(i, i, count) for i, count in enumerate(tracked)] == [""] * len(tracked)
    assert [upkeep.update(i, i, 70) for i in range(4)] == ["", "", "", "rekey"]
    upkeep.keyed(3, 70)
    assert [upkeep.update(i, i, 40) for i in range(4, 8)] == ["", "", "", "rekey"]
    upkeep.keyed(7, 40)
    assert {upkeep.update(i, i, 0) for i in range(8, 64)} == {""}
    assert upkeep.update(64, 64, 0) == "lost"
    upkeep.keep(66)
    assert {upkeep.update(i, i, 0) for i in range(67, 130)} == {""}
    assert upkeep.update(130, 130, 0) == "lost"


def test_points_are_seeded_where_a_contact_begins_once_a_touch() -> None:
    upkeep = ReseedingSchedule(0.8, math.inf)
    upkeep.restarted(0, 0, 100)
    causes = []
    for index in range(100):
        touches = 10 <= index < 60 or index >= 70
        upkeep.record_contact(touches, touches and index % 50 > 12)
        causes.append(upkeep.update(index, index, 100))
    assert {index: cause for index, cause in enumerate(causes) if cause} == {14: CONTACT, 71: CONTACT}


def test_a_window_around_the_contact_is_one_of_the_topography_view() -> None:
    """Points are seeded a window around a contact: 20 px of a view of half the scale are 10 px of the contact view, and
    not 14 px where pixels are twice as high as wide.
    """
    half, view = ((0.5, 0.0, 0.0), (0.0, 0.5, 0.0)), Rectangle((0, 40), (0, 40))
    calibration = CalibrationSettings(mm_per_px=0.02, topography_to_contact=half, intrinsics=(4e3, 2e3, 20, 20))
    geometry, region = Geometry(calibration, view, view), np.eye(1, 40, dtype=bool)
    recorded: Any = SimpleNamespace(_largest=region, usable=[1], _contact=lambda _: region, _gross_region=np.asarray)
    recorded.inputs = SimpleNamespace(scene=SimpleNamespace(kind="slip"), geometry=geometry)
    assert ContactStage.seeding_region(recorded, 20).sum() == 1 + 10
