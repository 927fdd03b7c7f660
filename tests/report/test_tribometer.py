"""Tests of a tribometer trace, from its file to figures S1 A and B."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from fingerflow.errors import FingerflowError
from fingerflow.plot.axes_style import GREY
from fingerflow.report.tribometer import TribometerTrace, draw_friction, draw_trace, read_tribometer

RATE = 500
COLUMNS = {"normal": "Fz", "tangential": "Ft", "position": "x", "amplitude": "envelope"}


def written(folder: Path, header: str = "time (s),Fz (mN),Ft (N),x (mm),envelope (um)") -> Path:
    """Write strokes of 2 s to the left and right with mu = 0.9 - 0.2 amplitude / um to the left while the envelope
    rises; return the file.
    """
    time = np.arange(4 * RATE) / RATE
    phase = 2 * np.pi * 4 * time + 1.0
    amplitude = 1.5 * (1 - np.cos(phase))
    leftwards = time < 2
    mu = 0.9 - 0.2 * amplitude + 0.3 * (np.sin(phase) < 0) + 0.5 * ~leftwards
    place = np.where(leftwards, 100 - 50 * time, 50 * (time - 2))
    rows = np.column_stack((time, np.full(len(time), 500.0), np.where(leftwards, 1, -1) * mu * 0.5, place, amplitude))
    path = folder / "trace.csv"
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.7g")
    return path


@pytest.fixture(scope="module")
def trace(tmp_path_factory: pytest.TempPathFactory) -> TribometerTrace:
    return read_tribometer(written(tmp_path_factory.mktemp("trace")), COLUMNS)


def test_signals_come_in_si_units(trace: TribometerTrace) -> None:
    assert float(trace.normal.mean()) == pytest.approx(0.5)
    assert float(trace.position.max()) == pytest.approx(0.1)
    assert float(trace.amplitude.max()) == pytest.approx(3e-6, rel=1e-3)
    assert len(trace.time) == 4 * RATE


def test_the_figure_shows_the_coefficient_of_the_file(trace: TribometerTrace) -> None:
    epochs = trace.epochs()
    assert len(epochs.start) == 7
    axes = Figure().subplots()
    draw_friction(axes, epochs)
    assert sum(line.get_color() == GREY for line in axes.lines) == 7
    whole = next(line for line in axes.lines if line.get_marker() == "o")
    x, y = (np.asarray(values, dtype=float) for values in whole.get_data())
    np.testing.assert_allclose(x, 0.25 + 0.5 * np.arange(6), atol=0.01)
    np.testing.assert_allclose(y, 0.9 - 0.2 * x, atol=0.005)
    assert axes.get_legend().get_texts()[0].get_text() == "median and quartiles of 7 epochs"


def test_epochs_are_shaded_in_every_trace(trace: TribometerTrace) -> None:
    epochs = trace.epochs()
    axes = list(Figure().subplots(4, 1, sharex=True))
    draw_trace(axes, trace, epochs)
    assert [len(one.patches) for one in axes] == [7] * 4
    first = axes[0].patches[0]
    assert first.get_x() == pytest.approx(float(trace.time[epochs.start[0]]))
    assert "7 epochs" in axes[0].get_title()
    np.testing.assert_allclose(axes[2].lines[0].get_ydata()[0], 100)  # mm
    np.testing.assert_allclose(np.max(axes[3].lines[0].get_ydata()), 3, rtol=1e-3)  # um
    ratio = np.asarray(axes[1].lines[0].get_ydata())
    middle = int(epochs.start[0] + epochs.stop[0]) // 2
    assert ratio[middle] == pytest.approx(0.6, abs=0.03)


def test_units_may_be_given(tmp_path: Path) -> None:
    path = written(tmp_path, header="time,Fz,Ft,x,envelope")
    units = {"Fz": "mN", "Ft": "N", "x": "mm", "envelope": "um"}
    assert float(read_tribometer(path, COLUMNS, units).position.max()) == pytest.approx(0.1)
    with pytest.raises(FingerflowError, match="'x' is in 'N', which is not known"):
        read_tribometer(path, COLUMNS, {**units, "x": "N"})


def test_mistakes_name_file_value_and_remedy(tmp_path: Path) -> None:
    path = written(tmp_path)
    with pytest.raises(FingerflowError, match=r"has no column 'normal'; its columns are .*'Fz'"):
        read_tribometer(path)
    with pytest.raises(FingerflowError, match="no signal 'force'; name normal"):
        read_tribometer(path, {"force": "Fz"})
    volts = written(tmp_path, header="time (s),Fz (V),Ft (N),x (mm),envelope (um)")
    with pytest.raises(FingerflowError, match="normal, column 'Fz', is in V: multiply"):
        read_tribometer(volts, COLUMNS)
    with pytest.raises(FingerflowError, match=r"trace\.csv: the envelope has .* not modulated"):
        read_tribometer(written(tmp_path), COLUMNS).epochs(modulation_hz=7.0)


def test_a_finger_at_rest_is_drawn_without_epochs(trace: TribometerTrace) -> None:
    still = replace(trace, position=0 * trace.position)
    epochs = still.epochs()
    figure = Figure(layout="constrained")
    axes = list(figure.subplots(5, 1))
    draw_trace(axes[:4], still, epochs)
    draw_friction(axes[4], epochs)
    figure.savefig(io.BytesIO(), dpi=40)
    assert not axes[0].patches
    assert axes[4].get_legend().get_texts()[0].get_text() == "median and quartiles of 0 epochs"
