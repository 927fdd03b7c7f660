"""Tests of [forces]: units, sign, gain, offset, tare and two components give the forces of a synthetic press in N;
forces that contradict themselves or the recording give an error or a warning with the remedy.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from fingerflow import process
from fingerflow.errors import FingerflowError
from fingerflow.synthetic import rebuild_scene
from tests.pipeline.stages.conftest import Change
from tests.small_trials import warnings_of

OUTPUTS = ["normal_force", "tangential_force", "load_ratio", "force_angle", "tangential_direction"]
NAMED, HEADING = 'normal = "fz"\ntangential = "fx"\n', "time (s),fz{0},fx{0},trigger (V)"


def channels_in(press: Path) -> str:
    """Return the lines of the scene that name both forces, with the comments between."""
    text, last = (press / "scene.toml").read_text(encoding="utf-8"), 'tangential = "tangential_force"'
    return text[text.index("normal = ") : text.index(last)] + last


def sampled(press: Path) -> np.ndarray[Any, Any]:
    """Return the samples (n, 4) of the force file: s, N, N, V."""
    return np.loadtxt(press / "forces.csv", delimiter=",", skiprows=1)


@pytest.fixture
def processed(changed: Change, press: Path, tmp_path: Path) -> Any:
    """Return a function that processes the forces of the press from another file and with other settings."""

    def run(columns: np.ndarray[Any, Any], heading: str, settings: str | None = None, **texts: str) -> xr.Dataset:
        np.savetxt(tmp_path / "sensor.csv", columns, fmt="%.9g", delimiter=",", header=heading, comments="")
        replaced = {(press / "forces.csv").as_posix(): "sensor.csv", **texts}
        if settings is not None:
            replaced[channels_in(press)] = settings
        return process(changed(replaced), OUTPUTS)

    return run


@pytest.fixture(scope="module")
def expected(press: Path) -> xr.Dataset:
    return process(press / "scene.toml", OUTPUTS)


@pytest.mark.parametrize(
    ("scale", "zero", "unit", "settings"),
    [
        pytest.param(1e-3, 0.0, "", 'units = "mN"', id="mN"),
        pytest.param(9.80665, 0.0, " (N)", 'units = "kgf"', id="kgf over a wrong heading"),
        pytest.param(2.5e-3, 0.0, " (mV)", "gain = 2.5", id="mV"),
        pytest.param(1e-3, 730.0, " (mN)", "offset = 730", id="offset in the unit of the file"),
        pytest.param(-2.0, -0.4, " (V)", "offset = [-0.4, -0.4]\nsign = -1\ngain = 2.0", id="an offset each"),
    ],
)
def test_readings_become_newtons(
    processed: Any, press: Path, expected: xr.Dataset, scale: float, zero: float, unit: str, settings: str
) -> None:
    """Readings in any unit give the forces in N, to the digits written in the file (1e-5 N)."""
    columns = sampled(press)
    columns[:, 1:3] = columns[:, 1:3] / scale + zero
    result = processed(columns, HEADING.format(unit), NAMED + settings)
    for name in OUTPUTS[:2]:
        np.testing.assert_allclose(result[name], expected[name], atol=2e-5)


def test_tare_is_the_mean_while_nothing_touches(processed: Any, press: Path, expected: xr.Dataset) -> None:
    """The tare is the mean over an interval without contact; the press touches 0.02 s after the trigger. Noise of 5 mN
    over 1200 samples leaves 0.15 mN.
    """
    columns, heading = np.add(sampled(press), (0, 3.0, -0.7, 0)), HEADING.format(" (N)")
    result = processed(columns, heading, NAMED + "tare = [-0.12, 0.0]")
    resting = sampled(press)
    resting = resting[(resting[:, 0] >= -0.12) & (resting[:, 0] <= 0)]
    for k, name in enumerate(OUTPUTS[:2], start=1):
        np.testing.assert_allclose(result[name], expected[name] - resting[:, k].mean(), atol=2e-5)
    assert "forces.tare" not in warnings_of(result)
    loaded = warnings_of(processed(columns, heading, NAMED + "tare = [0.1, 0.5]"))
    assert "changes by" in loaded
    assert "is the finger off" in loaded
    with pytest.raises(FingerflowError, match=r"forces\.tare is \[50, 60\] s from the trigger, and no sample of 'fz'"):
        processed(columns, heading, NAMED + "tare = [50, 60]")


def test_two_components(processed: Any, press: Path, expected: xr.Dataset) -> None:
    """A sensor turned by 0.7 rad gives the same tangential force, and its direction where the force
    exceeds its noise. The position of the actuator, 1 mm a N here, has a unit of its own.
    """
    columns, turned = sampled(press), 0.7
    along = 20 * columns[:, 2]
    of_forces = np.column_stack((columns[:, 1], along * np.cos(turned), along * np.sin(turned)))
    six = np.column_stack((columns[:, 0], 1e3 * of_forces, columns[:, 3], 1e3 * columns[:, 1]))
    heading = "time (s),fz (mN),fx (mN),fy (mN),trigger (V),travel (um)"
    settings = 'normal = "fz"\ntangential = ["fx", "fy"]\nunits = "mN"\nposition = '
    for travel in ('"travel"', 6):
        result = processed(six, heading, f"{settings}{travel}")
        np.testing.assert_allclose(result["actuator_position"], expected["normal_force"], atol=1e-4)
    np.testing.assert_allclose(result["tangential_force"], np.abs(20 * expected["tangential_force"]), atol=1e-4)
    pulls = result["tangential_force"].values > 0.05
    assert pulls.sum() >= 3
    np.testing.assert_allclose(result["tangential_direction"].values[pulls], turned, atol=1e-4)
    assert np.isnan(result["tangential_direction"].values[~pulls]).all()


def test_ratio_and_angle_are_nan_where_nothing_presses(expected: xr.Dataset) -> None:
    normal, tangential = expected["normal_force"].values, expected["tangential_force"].values
    presses = normal > 0.05
    assert 0 < presses.sum() < len(normal)
    np.testing.assert_allclose(expected["load_ratio"].values[presses], tangential[presses] / normal[presses])
    angle = np.arctan2(tangential[presses], normal[presses])
    np.testing.assert_allclose(expected["force_angle"].values[presses], angle)
    for name in ("load_ratio", "force_angle"):
        assert np.isnan(expected[name].values[~presses]).all()


def test_forces_and_frames_have_one_clock(changed: Change, press: Path) -> None:
    """Time 0 is the trigger for forces and frames: the force of a frame is the true one, to its noise and the low-pass
    filter.

    An offset of one frame, an eighth of a second here, would give an error of up to 0.9 N.
    """
    truth, names = rebuild_scene(press), ["normal_force", "tangential_force"]
    result = process(changed(), names)
    np.testing.assert_allclose(result["time"], truth.times, atol=1e-12)
    # The filter's cutoff at half the frame rate rounds the start and the end of a rise this fast.
    inner = slice(2, 6)
    np.testing.assert_allclose(result["normal_force"][inner], truth.normal_force(truth.times)[inner], atol=0.1)
    part = process(changed({"# first_frame = 0": "first_frame = 3"}), names)
    np.testing.assert_allclose(part["time"], truth.times[3:], atol=1e-12)
    np.testing.assert_allclose(part["normal_force"][:3], truth.normal_force(truth.times)[3:6], atol=0.1)


@pytest.mark.parametrize(
    ("columns", "heading", "settings", "message"),
    [
        ([1, 1, 1, 1], HEADING.format(""), NAMED + 'units = "V"', r"csv: column 'fz' .* is in V, not in N; give"),
        ([1, 1, 1, 1], HEADING.format(" (V)"), NAMED, r"csv: column 'fz' .* is in V, not in N; give"),
        ([1, -1, 1, 1], HEADING.format(" (N)"), NAMED, r"between -\d.* N: pressing must be positive; give .*sign = -1"),
        ([1, np.nan, 1, 1], HEADING.format(" (N)"), NAMED, ""),
        ([1, np.inf, 1, 1], HEADING.format(" (N)"), NAMED, ""),
    ],
)
def test_what_cannot_be_a_force_is_said(
    processed: Any, press: Path, columns: list[float], heading: str, settings: str, message: str
) -> None:
    samples = sampled(press) * columns
    if message:
        with pytest.raises(FingerflowError, match=message):
            processed(samples, heading, settings)
        return
    result = processed(samples, heading, settings)
    assert np.isnan(result["normal_force"].values).all()
    assert np.isfinite(result["tangential_force"].values[1:]).all()
    assert f"sensor.csv: {len(samples)} of {len(samples)} samples of 'fz' are NaN" in warnings_of(result)


def test_a_doubtful_force_is_said(processed: Any, press: Path) -> None:
    samples, heading = sampled(press), HEADING.format(" (N)")
    assert warnings_of(processed(samples, heading, NAMED)) == ""
    doubled = processed(samples, heading.replace("(V)", "(N)"), NAMED)
    assert "the trigger 'trigger' is in N, as a force is" in warnings_of(doubled)
    offset = warnings_of(processed(np.add(samples, (0, 2.0, 0, 0)), heading, NAMED))
    assert "'fz' is never below 1.99 N; if the finger was off the glass" in offset
    low = warnings_of(processed(np.add(samples, (0, -2.0, 0, 0)), heading, NAMED))
    assert "'fz' falls to -2" in low
    with pytest.raises(FingerflowError, match=r"between -20 and .* give \[forces\] offset or tare"):
        processed(np.add(samples, (0, -20.0, 0, 0)), heading, NAMED)
    untold = warnings_of(processed(samples, heading, NAMED, **{"trigger_frame = 1": ""}))
    assert "nothing says in which frame it came: frame 0 is taken; give [recording] trigger_frame" in untold
    weak = processed(samples * (1, 1e-3, 1, 1), heading, NAMED)
    assert "never above 0.05 N: check frame rate" in warnings_of(weak)
    short = processed(samples[: len(samples) // 2], heading, NAMED)
    assert "forces do not cover" in warnings_of(short)
