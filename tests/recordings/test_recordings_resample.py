"""Tests of forces on the clock of the frames, against analytic truth: alignment to the trigger, anti-aliased values."""

from pathlib import Path

import numpy as np
import pytest

from fingerflow.errors import FingerflowError
from fingerflow.recordings import Forces

RATE = 10_000
TIMES = np.arange(0, 1.5, 1 / RATE)
FRAMES = 0.2137 + np.arange(300) / 300  # the ratio of the rates is not an integer; all kernels lie inside


def forces(times=TIMES, trigger=None, **channels):
    return Forces(Path("forces.csv"), times, channels, dict.fromkeys(channels, "N"), trigger=trigger)


def uneven_times() -> np.ndarray:
    """Return times (3000,) s at 2 kHz, up to 0.4 of a step early or late."""
    return (np.arange(3000) + np.random.default_rng(2).uniform(-0.4, 0.4, 3000)) / 2000


# Alignment


def test_trigger_is_found_between_the_samples():
    edge = 0.31234567
    ramp = np.clip((TIMES - edge) * 2000 + 2.5, 0, 5)  # rises through 2.5 at `edge`, over 25 samples
    aligned = forces(trigger="sync", sync=ramp, normal=TIMES).align(trigger_level=2.5)
    # Linear interpolation of a straight edge is exact up to rounding.
    assert aligned.channels["normal"][0] - aligned.times[0] == pytest.approx(edge, abs=1e-12)
    assert np.interp(0.0, aligned.times, aligned.channels["sync"]) == pytest.approx(2.5, abs=1e-9)


@pytest.mark.parametrize(
    ("signal", "rises"),
    [
        (np.select([TIMES < 0.01, TIMES < 0.5, TIMES < 0.6, TIMES < 0.8], [5.0, 0.0, 5.0, 0.0], 5.0), 0.49995),
        (np.where(TIMES < 0.5, 0.0, 2.5), 0.5),
    ],
    ids=["falls first and rises twice", "reaches the level exactly"],
)
def test_the_first_rising_edge_counts(signal, rises):
    assert -forces(trigger="sync", sync=signal).align(2.5).times[0] == pytest.approx(rises, abs=1e-12)


@pytest.mark.parametrize(
    ("channels", "named"),
    [
        ({"trigger": "sync", "sync": np.where(TIMES > 1, 1.0, 0.0)}, "lies between 0 and 1"),
        ({"trigger": "sync", "sync": np.where(TIMES > 1, 0.0, 5.0)}, "never rises"),
        ({"normal": TIMES}, "trigger=.*'normal'"),
    ],
)
def test_no_trigger(channels, named):
    with pytest.raises(FingerflowError, match=named):
        forces(**channels).align(2.5)


# Resampling


def resampled(frequency: float, times: np.ndarray = TIMES) -> tuple[np.ndarray, np.ndarray]:
    signal = forces(times, x=np.sin(2 * np.pi * frequency * times + 0.3)).resample(FRAMES)["x"]
    return signal, np.sin(2 * np.pi * frequency * FRAMES + 0.3)


@pytest.mark.parametrize("frequency", [0.5, 20, 75])
def test_pass_band_keeps_amplitude_and_phase(frequency):
    # Up to half of the Nyquist frequency of 150 Hz. Kaiser window of 66 dB: ripple 0.05 %; measured 0.04 %.
    signal, truth = resampled(frequency)
    assert np.abs(signal - truth).max() < 1e-3


@pytest.mark.parametrize("frequency", [150, 225, 300, 400, 4321])
def test_what_the_frames_cannot_show_is_gone(frequency):
    # 400 Hz would appear as 100 Hz with its full amplitude, and averaging over a frame would leave 21 % of it.
    signal, _ = resampled(frequency)
    assert np.abs(signal).max() < 1e-3


@pytest.mark.parametrize("times", [TIMES, uneven_times(), np.arange(0, 1.5, 1 / 1234.5), np.arange(0, 1.5, 1 / 310)])
def test_constants_and_ramps_are_exact_up_to_the_ends(times):
    frames = np.arange(times[0], times[-1], 1 / 300)
    values = forces(times, constant=np.full(times.size, 7.25), ramp=3 * times - 1).resample(frames)
    np.testing.assert_allclose(values["constant"], 7.25, rtol=1e-13)
    np.testing.assert_allclose(values["ramp"], 3 * frames - 1, atol=1e-12)


def test_frames_outside_the_forces_are_nan_and_counted():
    record = forces(x=np.ones(TIMES.size))
    frames = np.arange(-30, 500) / 300
    values = record.resample(frames)["x"]
    outside = (frames < 0) | (frames > TIMES[-1])
    np.testing.assert_array_equal(np.isnan(values), outside)
    covered = f"the forces do not cover {outside.sum()} of 530 frames (NaN there): is the trigger right?"
    assert record.warnings == [covered]
    record.resample(frames)
    assert len(record.warnings) == 1  # warned once


def test_a_trigger_within_a_step_leaves_the_first_frame_covered() -> None:
    """A record that begins with the first frame covers it, although its trigger rises half a step before a sample: the
    first sample is then half a step late.
    """
    times = np.arange(-250, 9501) / 10_000
    aligned = forces(times, "t", x=np.ones(times.size), t=5.0 * (times >= 0)).align(2.5)
    assert aligned.times[0] == pytest.approx(-0.02495, abs=1e-12)
    np.testing.assert_allclose(aligned.resample(np.arange(-1, 39) / 40)["x"], 1, rtol=1e-12)
    assert aligned.warnings == []
    late = aligned.resample(np.arange(-1, 39) / 40 - 2e-6)["x"]  # by 2 % of a step more
    assert np.isnan(late[0])
    assert np.isfinite(late[1:]).all()


@pytest.mark.parametrize(
    ("times", "frames", "cause"),
    [
        (TIMES, FRAMES + 10, r"0 to 1\.4999 s, the frames from 10\.2137 to 11\.2104 s"),
        (TIMES * 1e3, FRAMES, r"last 1\.5e\+03 s, the 300 frames 0\.997 s.*unit of the times"),  # ms read as s
        (TIMES * 1e6, FRAMES, "unit of the times"),
        (TIMES * 1e-3, FRAMES - FRAMES[0], "unit of the times"),  # s read as ms
        (TIMES / 60, FRAMES - FRAMES[0], "unit of the times"),
        (np.arange(-2.0, 30) * 5, FRAMES, "unit of the times"),  # 0.2 Hz
    ],
)
def test_forces_of_another_time_than_the_frames(times: np.ndarray, frames: np.ndarray, cause: str) -> None:
    with pytest.raises(FingerflowError, match=cause):
        forces(times, x=np.ones(times.size)).resample(frames)


def test_forces_slower_than_the_frames_are_interpolated_and_it_is_said():
    times = np.arange(0, 1.5, 0.01)
    record = forces(times, x=times**2)
    np.testing.assert_allclose(record.resample(FRAMES)["x"], np.interp(FRAMES, times, times**2), rtol=1e-12)
    assert "no faster than the frames (forces at 100 Hz, frames at 300 Hz)" in record.warnings[0]


def test_a_sample_that_is_nan_is_one_that_is_missing():
    """A NaN sample counts as missing: one at 10 kHz has no effect, half a second is a gap in this channel only."""
    one, many = 2 + TIMES, 2 + TIMES
    one[7000] = np.nan
    many[5000:10000] = np.inf
    record = forces(x=one, y=many, z=np.full(TIMES.size, np.nan), t=2 + TIMES)
    result = record.resample(FRAMES)
    np.testing.assert_allclose(result["x"], result["t"], atol=1e-3)
    in_gap = (TIMES[4999] < FRAMES) & (TIMES[10000] > FRAMES)
    np.testing.assert_array_equal(np.isnan(result["y"]), in_gap)
    np.testing.assert_allclose(result["y"][~in_gap], result["t"][~in_gap], atol=0.2 / 300)
    assert np.isnan(result["z"]).all()
    assert any("z: no sample is a number" in warning for warning in record.warnings)
    assert list(result) == ["x", "y", "z", "t"]


@pytest.mark.parametrize("frames", [[], [np.nan, 1.0], [[0.1, 0.2]]])
def test_frame_times_that_are_none(frames):
    with pytest.raises(FingerflowError, match="frame times"):
        forces(x=TIMES).resample(frames)


@pytest.mark.parametrize(
    ("times", "samples", "named"),
    [([], 0, "no samples"), ([0, 1, np.inf], 3, "is inf"), ([0, 1, 2], 2, "'x' has 2 samples for 3")],
)
def test_wrong_times_of_forces_are_refused(times, samples, named):
    with pytest.raises(FingerflowError, match=named):
        forces(np.array(times, float), x=np.zeros(samples))
