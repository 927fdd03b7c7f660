"""What the gauge length smooths away is stated."""

from collections.abc import Callable

import numpy as np
import pytest

from fingerflow.engines.engine import Engine, EngineSettings, FrameEllipse
from fingerflow.tracker.deviations.smoothing import SmoothingErrors

GAUGE = 1.6
MakeEngine = Callable[[EngineSettings], Engine]


def _stated_over_true(make_engine: MakeEngine, length: float, inside: bool) -> float:
    """Return the RMS of stated over that of true errors of divergence for a wave of displacement without noise."""
    axis = np.arange(-4, 4.01, 0.2)
    places = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    places += np.random.default_rng(1).uniform(-0.05, 0.05, places.shape)
    number = 2 * np.pi / length
    moved = 0.1 * np.stack((np.sin(number * places[:, 0]), np.cos(number * places[:, 1])), -1)[None]
    true = 0.1 * number * (np.cos(number * places[:, 0]) - np.sin(number * places[:, 1]))
    engine = make_engine(EngineSettings(gauge_length_mm=GAUGE))
    ellipse = FrameEllipse(*(np.array(values, np.float32) for values in ([[0, 0]], [[3, 3]], [0])))
    exact = np.zeros((1, len(places), 2, 2), np.float32)
    fields, wide = (
        engine.fields(*(values.astype(np.float32) / scale for values in (places, moved)), ellipse, exact)
        for scale in (1, 2)
    )
    stated = SmoothingErrors(GAUGE, places).variance(places, moved, fields, wide)[0, 0]
    depth = 4 - np.abs(places).max(1)
    some = depth > GAUGE if inside else depth < 0.2
    return float(np.sqrt(stated[some].mean() / np.square((fields.divergence[0] - true)[some]).mean()))


@pytest.mark.parametrize("length", [2.0, 3.2, 6.4])
def test_smoothing_is_stated_inside(make_engine: MakeEngine, length: float) -> None:
    """The stated error by smoothing is that of long waves, and 0.7 times that of waves little longer than a gauge
    length (`SmoothingErrors` says why).
    """
    assert 0.65 < _stated_over_true(make_engine, length * GAUGE / 1.6, inside=True) < 1.1


def test_smoothing_is_stated_at_the_border(make_engine: MakeEngine) -> None:
    """The error of one-sided fits is stated for fields that rise over a third of a gauge length; of a slope that
    changes over lengths beyond the gauge, it is 1.65 times the true one.
    """
    assert 1 < _stated_over_true(make_engine, 8.0, inside=False) < 1.75
