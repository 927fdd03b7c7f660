"""Tests of the row of a trial whose series are formulas of time, so that every number is known."""

import json

import numpy as np
import pytest
import xarray as xr

from fingerflow.schema.trial_columns import NUMBERS
from fingerflow.study.row import FORCE_GRID, SHARE_GRID, measure

FRAMES, RATE = 101, 100.0
TIME = np.arange(FRAMES) / RATE
FORCE = 5.0 * TIME  # N; 1 N in frame 20
ANGLE = 0.4


def _result(**changed: np.ndarray) -> xr.Dataset:
    """Return a result with contact from frame 10 on; per N a divergence of 0.01, a strain of 0.02 along ANGLE and -0.01
    across.
    """
    area = np.where(np.arange(FRAMES) >= 10, 10 * FORCE, 0.0)
    along = np.array([np.cos(ANGLE), np.sin(ANGLE)])
    across = np.array([-np.sin(ANGLE), np.cos(ANGLE)])
    tensor = 0.02 * np.outer(along, along) - 0.01 * np.outer(across, across)
    strain = FORCE[:, None] * np.array([tensor[0, 0], tensor[1, 1], tensor[0, 1]])
    rates = np.broadcast_to(5.0 * np.array([tensor[0, 0], tensor[1, 1], tensor[0, 1]]), (FRAMES, 3))
    moved = np.zeros((FRAMES, 4, 2))
    moved[:, :, 0] = TIME[:, None] * np.array([0.1, 0.2, 0.3, 9.0])  # the last point never touches
    covered = np.ones((FRAMES, 4), np.uint8)
    covered[:, 3] = 0
    status = np.zeros((FRAMES, 4), np.uint8)
    status[:, 2] = 5
    values = {
        "normal_force": FORCE, "load_ratio": np.full(FRAMES, -0.3), "gross_contact_area": area,
        "real_contact_area": area / 2, "median_divergence": 0.01 * FORCE, "median_divergence_std": 0.001 * FORCE,
        "median_divergence_rate": np.full(FRAMES, 0.05), "ellipse_angle": np.full(FRAMES, ANGLE),
        "global_displacement": 0.04 * TIME, "global_displacement_std": 0.01 * TIME,
        "frame_status": np.zeros(FRAMES, np.uint8),
    }  # fmt: skip
    values |= changed
    data = {name: ("frame", one) for name, one in values.items()}
    data |= {
        "median_strain": (("frame", "strain_component"), strain),
        "median_strain_std": (("frame", "strain_component"), np.full((FRAMES, 3), 1e-4)),
        "median_strain_rate": (("frame", "strain_component"), rates),
        "median_strain_rate_std": (("frame", "strain_component"), rates / 10),
        "ellipse_semi_axes": (("frame", "axis"), np.tile([3.0, 2.0], (FRAMES, 1))),
        "displacement": (("frame", "point", "xy"), moved),
        "in_contact": (("frame", "point"), covered),
        "status": (("frame", "point"), status),
    }
    attributes = {"settings": json.dumps({"fields": {"rate_window_s": 0.05}}), "warnings": json.dumps(["one", "two"])}
    return xr.Dataset(data, {"time": ("frame", TIME)}, attributes)


@pytest.mark.parametrize("dip", [0.0, 1.5])
def test_values_at_forces_lie_on_the_line_between_frames(dip: float) -> None:
    """Also where the force is lower by 1.5 N in the frame before it reaches 2.25 N, where 0.0153 were taken."""
    force = FORCE - dip * (np.arange(FRAMES) == 45)
    series = {"median_divergence": 0.01 * force, "median_divergence_std": 0.001 * force}
    row, curves = measure(_result(normal_force=force, **series))
    for force in (1, 2, 3):
        assert row[f"divergence_at_{force}n"] == pytest.approx(0.01 * force, rel=1e-12)
        assert row[f"divergence_at_{force}n_std"] == pytest.approx(0.001 * force, rel=1e-12)
        assert row[f"gross_contact_area_at_{force}n"] == pytest.approx(10 * force, rel=1e-12)
    known = [value for value in curves["divergence"] if value is not None]
    # The finger touches at 0.5 N and is pressed with 5 N.
    assert known == pytest.approx(0.01 * FORCE_GRID[1:20], rel=1e-12)
    assert len(curves["divergence"]) == len(FORCE_GRID)


def test_numbers_of_the_whole_trial() -> None:
    row, _ = measure(_result())
    expected = {
        "max_force": 5.0, "time_to_max_force": 0.9, "duration": 0.9, "force_rate": 5.0, "divergence": 0.05,
        "divergence_at_onset": 0.005, "divergence_rate": 0.05, "global_displacement": 0.04,
        "global_displacement_std": 0.01,
        "force_angle": np.arctan(0.3), "strain": 0.1, "strain_across": -0.05, "strain_rate": 0.1,
        "longest_axis_ratio": 1.5, "coverage": 2 / 3,
        # The 0.99 quantile of three points is the second one; the fourth never touches.
        "max_displacement": 0.2, "max_speed": 0.2, "contact_exponent": 1.0,
    }  # fmt: skip
    for name, value in expected.items():
        assert row[name] == pytest.approx(value, rel=1e-9), name
    assert row["friction"] is None
    assert row["warnings"] == "one\ntwo"
    assert set(NUMBERS) <= set(row)


def test_frames_that_are_not_usable_are_in_no_number() -> None:
    status = np.zeros(FRAMES, np.uint8)
    status[[50, 100]] = 3
    force = FORCE.copy()
    force[50] = 99.0
    row, _ = measure(_result(frame_status=status, normal_force=force))
    assert row["max_force"] == pytest.approx(FORCE[99])
    assert row["divergence"] == pytest.approx(0.01 * FORCE[99])
    assert row["usable_frames"] == FRAMES - 2
    assert row["divergence_at_2n"] == pytest.approx(0.02)


def test_nothing_is_made_up_where_a_force_does_not_come() -> None:
    row, curves = measure(_result(normal_force=FORCE / 4))
    assert row["divergence_at_2n"] is None
    assert row["divergence_at_3n_std"] is None
    assert row["divergence_at_1n"] is not None
    assert all(value is None for force, value in zip(FORCE_GRID, curves["divergence"], strict=True) if force > 1.25)


def test_without_contact_nothing_and_without_forces_the_largest_area_counts() -> None:
    row, curves = measure(_result(gross_contact_area=np.zeros(FRAMES)))
    assert all(row[name] is None for name in NUMBERS)
    assert curves == {}
    row, curves = measure(_result().drop_vars(["normal_force", "load_ratio"]))
    assert row["max_force"] is None
    assert row["divergence"] == pytest.approx(0.05)
    assert row["divergence_at_1n"] is None
    assert curves == {}


def test_laws_of_contact_and_full_slip() -> None:
    """Friction is that where no skin sticks. The area grows as k N^0.5, by another k when the force falls, and with a
    time of 0.05 s while it is held; the last skin slips in frame 60, 0.5 s after the load began. Until a tenth has
    slipped the tangential force grows by 2 N/mm.
    """
    force = np.interp(TIME, [0, 0.4, 0.8, 1], [0, 5, 5, 0])
    load = 0.6 * np.clip(TIME - 0.1, 0, 0.5) / 0.5
    stuck = np.interp(load / 0.6, [0, 0.5, 1], [1, 0.95, 0])
    result = _result(
        normal_force=force, load_ratio=load, stuck_ratio=stuck, tangential_force=load * force,
        gross_contact_area=np.where(TIME > 0.5, 12, 10) * force**0.5, gross_contact_area_std=0.1 * force**0.5,
        real_contact_area=20 - 5 * np.exp((0.4 - TIME) / 0.05), actuator_position=load * force / 2 + (stuck < 0.9),
    )  # fmt: skip
    verdict = {"loss_frame": 60, "loss_load_ratio": 0.6, "area_noise": 0.01, "load_noise": 0.02}
    result["stuck_ratio"].attrs["verdict"] = json.dumps({"outcome": "diminishes"} | verdict)
    row, curves = measure(result)
    deviation = np.hypot(0.01 / 12**0.5, 0.01 / 3.8)
    expected = {
        "contact_exponent": 0.5, "contact_exponent_std": 0.0, "contact_time_constant": 0.05,
        "unloading_area_ratio": 1.2, "unloading_area_ratio_std": 1.2 * np.hypot(0.1 / 10, 0.1 / 12),
        "friction": 0.6, "friction_force": np.median(force[60:]),
        "full_slip_load_ratio": 0.6, "full_slip_load_ratio_std": 0.012, "full_slip_time": 0.48,
        "full_slip_time_std": deviation, "full_slip_displacement": 0.48 * 0.2,
        "full_slip_displacement_std": 0.2 * deviation, "tangential_stiffness": 2.0, "tangential_stiffness_std": 0.0,
    }  # fmt: skip
    assert {name: row[name] for name in expected} == pytest.approx(expected, rel=0.02, abs=1e-6)
    area, pressure = SHARE_GRID**0.5, 100 * (5 * SHARE_GRID) ** 0.5
    for name, truth in {
        "stuck_ratio": np.interp(SHARE_GRID, [0, 0.5, 1], [1, 0.95, 0]), "relative_area": area,
        "relative_area_unloading": 1.2 * area, "mean_pressure": pressure, "mean_pressure_unloading": pressure / 1.2,
    }.items():  # fmt: skip
        np.testing.assert_allclose(np.array(curves[name], float)[5:-1], truth[5:-1], rtol=0.01, atol=1e-9, err_msg=name)
