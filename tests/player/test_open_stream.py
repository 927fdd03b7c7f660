"""Tests of the folder of a stream read as a data set, a report and a table."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from tiny_bundle import Stream, frame
from typer.testing import CliRunner

import fingerflow
from fingerflow.cli import app
from fingerflow.errors import FingerflowError
from fingerflow.report import write_report
from fingerflow.tracker.frame_results import RESULTS

RATE = "[recording]\nframe_rate = 40.0\ntrigger_frame = 2\n"
FAST = ("--rate", "40")


@pytest.fixture
def played(stream: Stream) -> Path:
    """Return the results folder of a stream of eight frames with ten points, of which the last two frames lose three;
    the contact grows by 800 px a frame.
    """
    text = stream.scene.read_text()
    matrix = "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]"
    assert matrix in text
    stream.scene.write_text(text.replace(matrix, "[[2.0, 0.0, 1.0], [0.0, 2.0, -1.0]]"))
    frames = [frame(found=10 if number < 6 else 7, contact_px=800 * number) for number in range(8)]
    assert stream.run(*stream.frames(frames), "--policy", "every").code == 0
    return stream.folder / "results"


def test_report_and_tables(played: Path, tmp_path: Path) -> None:
    with pytest.raises(FingerflowError, match="name the results folder of a stream"):
        fingerflow.open_stream(tmp_path)
    assert set(RESULTS) <= set(fingerflow.open_stream(played).data_vars)  # no variable of the records is left out
    assert CliRunner().invoke(app, ["report", str(played)], catch_exceptions=False).exit_code == 0
    page = (played / "report.html").read_text(encoding="utf-8")
    assert "fingertip on glass, a stream" in page
    assert "<td>scale</td><td>0.50000 mm/px</td>" in page
    for name in ("table.mat", "table.csv"):
        assert CliRunner().invoke(app, ["export-table", str(played), str(tmp_path / name)]).exit_code == 0
    table = scipy.io.loadmat(tmp_path / "table.mat")
    np.testing.assert_array_equal(table["real_contact_area"].ravel(), np.arange(8) * 200.0)
    assert table["position_px"].shape == (8, 10, 2)
    assert "real_contact_area (mm²)" in (tmp_path / "table.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    (played / "records.bin").write_bytes(b"")
    with pytest.raises(FingerflowError, match="has no frame to report"):
        write_report(fingerflow.open_stream(played), None, played)


@pytest.mark.parametrize(("rate", "options", "zero"), [("", (), None), (RATE, (), 2), ("", FAST, 0)])
def test_time_is_that_of_the_recording_and_warnings_are_kept(
    rate: str, options: tuple[str, ...], zero: int | None, stream: Stream
) -> None:
    """With a frame rate `time` is that of the recording, from its trigger; without one it is that of arrivals, as a
    warning of the data set says.
    """
    stream.scene.write_text(stream.scene.read_text() + rate)
    assert stream.run(*stream.recorded(8), "--policy", "every", *options).code == 0
    result = fingerflow.open_stream(stream.folder / "results")
    assert ("`time` is that of arrivals" in result.attrs["warnings"]) == (zero is None)
    assert zero is None or np.array_equal(result["time"], (np.arange(8) - zero) / 40)
