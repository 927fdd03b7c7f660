"""Tests of the keys of [forces] (units, sign, gain, offset, tare, two components) against the forces of a synthetic
press.
"""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from fingerflow import process
from fingerflow.errors import FingerflowError
from fingerflow.schema.scene import Scene
from fingerflow.schema.scene_template import scene_text

Change = Callable[..., Scene]
OUTPUTS = ["normal_force", "tangential_force", "load_ratio", "force_angle", "tangential_direction"]


def channels_in(scene: Path) -> str:
    """Return the lines of a scene that name both forces, with the comments between."""
    text, last = scene.read_text(encoding="utf-8"), 'tangential = "tangential_force"'
    return text[text.index("normal = ") : text.index(last)] + last


def sampled(press: Path) -> np.ndarray[Any, Any]:
    """Return the samples (n, 4) of the force file: s, N, N, V."""
    return np.loadtxt(press / "forces.csv", delimiter=",", skiprows=1)


def written(folder: Path, columns: np.ndarray[Any, Any], heading: str) -> str:
    np.savetxt(folder / "sensor.csv", columns, fmt="%.9g", delimiter=",", header=heading, comments="")
    return "sensor.csv"


def processed(changed: Change, press: Path, file: str, settings: str) -> xr.Dataset:
    return process(
        changed({(press / "forces.csv").as_posix(): file, channels_in(press / "scene.toml"): settings}), OUTPUTS
    )


@pytest.fixture(scope="module")
def expected(press: Path) -> xr.Dataset:
    return process(press / "scene.toml", OUTPUTS)


NAMED = 'normal = "fz"\ntangential = "fx"\n'
READINGS: dict[str, tuple[float, float, str, str]] = {
    "mN": (1e-3, 0.0, "time (s),fz,fx,trigger (V)", 'units = "mN"'),
    "g": (9.80665e-3, 0.0, "time (s),fz,fx,trigger (V)", 'units = "g"'),
    "kgf over a wrong heading": (9.80665, 0.0, "time (s),fz (N),fx (N),trigger (V)", 'units = "kgf"'),
    "V": (2.5, 0.0, "time (s),fz (V),fx (V),trigger (V)", "gain = 2.5"),
    "V, no heading says so": (2.5, 0.0, "time (s),fz,fx,trigger (V)", 'units = "V"\ngain = [2.5, 2.5]'),
    "mV": (2.5e-3, 0.0, "time (s),fz (mV),fx (mV),trigger (V)", "gain = 2.5"),
    "pressing is negative": (-1.0, 0.0, "time (s),fz (N),fx (N),trigger (V)", "sign = -1"),
    "offset in the file's unit": (1e-3, 730.0, "time (s),fz (mN),fx (mN),trigger (V)", "offset = 730"),
    "an offset each": (
        -2.0,
        -0.4,
        "time (s),fz (V),fx (V),trigger (V)",
        "offset = [-0.4, -0.4]\nsign = -1\ngain = 2.0",
    ),
}


@pytest.mark.parametrize("kind", READINGS)
def test_readings_become_newtons(changed: Change, press: Path, tmp_path: Path, expected: xr.Dataset, kind: str) -> None:
    """Readings in any unit give the forces in N, to the digits written in the file (1e-5 N)."""
    scale, zero, heading, settings = READINGS[kind]
    columns = sampled(press)
    columns[:, 1:3] = columns[:, 1:3] / scale + zero
    result = processed(changed, press, written(tmp_path, columns, heading), NAMED + settings)
    for name in OUTPUTS[:2]:
        np.testing.assert_allclose(result[name], expected[name], atol=2e-5)


def test_tare_is_the_mean_while_nothing_touches(
    changed: Change, press: Path, tmp_path: Path, expected: xr.Dataset
) -> None:
    """The tare is the mean over an interval without contact; the press touches 0.02 s after the trigger. Noise of 5 mN
    over 1200 samples leaves 0.15 mN.
    """
    columns = sampled(press)
    columns[:, 1:3] += (3.0, -0.7)
    file = written(tmp_path, columns, "time (s),fz (N),fx (N),trigger (V)")
    result = processed(changed, press, file, NAMED + "tare = [-0.12, 0.0]")
    resting = sampled(press)
    resting = resting[(resting[:, 0] >= -0.12) & (resting[:, 0] <= 0)]
    for k, name in enumerate(OUTPUTS[:2], start=1):
        np.testing.assert_allclose(result[name], expected[name] - resting[:, k].mean(), atol=2e-5)
        assert abs(resting[:, k].mean()) < 0.0006
    assert not any("forces.tare" in said for said in json.loads(result.attrs["warnings"]))
    loaded = processed(changed, press, file, NAMED + "tare = [0.1, 0.5]")
    assert any("changes by" in said and "is the finger off" in said for said in json.loads(loaded.attrs["warnings"]))
    with pytest.raises(FingerflowError, match=r"forces\.tare is \[50, 60\] s from the trigger, and no sample of 'fz'"):
        processed(changed, press, file, NAMED + "tare = [50, 60]")


def test_two_components(changed: Change, press: Path, tmp_path: Path, expected: xr.Dataset) -> None:
    """A sensor turned by 0.7 rad gives the same tangential force, and its direction where the force
    exceeds its noise.
    """
    columns, turned = sampled(press), 0.7
    along = 20 * columns[:, 2]
    five = np.column_stack(
        (columns[:, 0], columns[:, 1], along * np.cos(turned), along * np.sin(turned), columns[:, 3])
    )
    file = written(tmp_path, five, "time (s),fz (N),fx (N),fy (N),trigger (V)")
    result = processed(changed, press, file, 'normal = "fz"\ntangential = ["fx", "fy"]')
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
    np.testing.assert_allclose(
        expected["force_angle"].values[presses], np.arctan2(tangential[presses], normal[presses])
    )
    for name in ("load_ratio", "force_angle"):
        assert np.isnan(expected[name].values[~presses]).all()
        assert expected[name].attrs["long_name"].endswith("NaN where the normal force is below 0.05 N")


def test_volts_without_a_gain_are_refused(changed: Change, press: Path, tmp_path: Path) -> None:
    file = written(tmp_path, sampled(press), "time (s),fz,fx,trigger (V)")
    with pytest.raises(FingerflowError, match=r"sensor\.csv: column 'fz' of the normal force is in V, not in N; give"):
        processed(changed, press, file, NAMED + 'units = "V"')


def test_a_file_without_a_heading_by_numbers(
    changed: Change, press: Path, tmp_path: Path, expected: xr.Dataset
) -> None:
    np.savetxt(tmp_path / "sensor.csv", sampled(press), fmt="%.9g", delimiter=";")
    text = (tmp_path / "sensor.csv").read_text().replace(".", ",")
    (tmp_path / "sensor.csv").write_text(text)
    scene = changed(
        {
            (press / "forces.csv").as_posix(): "sensor.csv",
            channels_in(press / "scene.toml"): 'normal = 2\ntangential = 3\ntime = 1\nunits = "N"',
            'trigger = "trigger"': "trigger = 4",
        }
    )
    result = process(scene, OUTPUTS)
    for name in OUTPUTS:
        np.testing.assert_allclose(result[name], expected[name], atol=2e-5)


def test_init_writes_the_keys() -> None:
    text = scene_text()
    for key in ("units", "gain", "sign", "offset", "tare"):
        assert f"\n# {key} = " in text
    shown = scene_text(forces="forces.csv").replace("\n# units", "\nunits").replace("\n# tare", "\ntare")
    assert tomllib.loads(shown)["forces"]["tare"] == [-0.5, -0.1]
