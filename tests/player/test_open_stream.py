"""Tests of the folder of a stream read as a data set, a report and a table."""

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from conftest import Stream
from tiny_bundle import HEIGHT, WIDTH, frame
from typer.testing import CliRunner

import fingerflow
from fingerflow.cli import app
from fingerflow.errors import FingerflowError
from fingerflow.ops.tracking.track_points import TrackStatus
from fingerflow.schema.variables import CONTACT, STREAM, TRACKING, by_name


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


def test_variables_have_their_definitions_and_the_values_of_the_records(played: Path) -> None:
    result = fingerflow.open_stream(played)
    known = by_name(CONTACT, TRACKING, STREAM)
    names = {"position", "position_px", "forward_backward_error", "status", "real_contact_area", "ellipse_center"}
    assert names | {"latency", "restart", "key_frame", "contact_threshold", "tracked_share"} <= set(result.data_vars)
    for name in names:
        assert result[name].dims == known[name].dims
        assert (result[name].attrs["units"], result[name].attrs["long_name"]) == (
            known[name].units,
            known[name].long_name,
        )
    assert result["status"].attrs["flag_meanings"].split() == [status.name.lower() for status in TrackStatus]
    np.testing.assert_array_equal(result["frame"], np.arange(8))
    assert result["time"].attrs["units"] == "s"
    assert list(result["xy"].values) == ["x", "y"]
    assert (result.attrs["mm_per_px"], json.loads(result.attrs["settings"])["views"]["height"]) == (0.5, HEIGHT)

    np.testing.assert_array_equal(result["real_contact_area"], np.arange(8) * 200.0)
    np.testing.assert_array_equal(result["contact_threshold"], 0.5)
    # The centre is in mm of the contact view, whatever the topography view is. The tolerance of 1 mm is two pixels, as
    # contact is summed over cells of pixels.
    np.testing.assert_allclose(result["ellipse_center"][1:, 0], 0.5 * (WIDTH - 1) / 2, atol=1)
    x, y = result["position_px"].values[0, 3]
    np.testing.assert_allclose(result["position"].values[0, 3], ((2 * x + 1) * 0.5, (2 * y - 1) * 0.5))
    assert np.isnan(result["position"].values[6:, 7:]).all()


def test_report_and_tables(played: Path, tmp_path: Path) -> None:
    with pytest.raises(FingerflowError, match="is no results folder of a stream"):
        fingerflow.open_stream(tmp_path)
    assert CliRunner().invoke(app, ["report", str(played)], catch_exceptions=False).exit_code == 0
    page = (played / "report.html").read_text(encoding="utf-8")
    assert "fingertip on glass, a stream" in page
    assert "<td>scale</td><td>0.50000 mm/px</td>" in page
    for name in ("table.mat", "table.csv"):
        ended = CliRunner().invoke(app, ["export-table", str(played), str(tmp_path / name)], catch_exceptions=False)
        assert ended.exit_code == 0
    table = scipy.io.loadmat(tmp_path / "table.mat")
    np.testing.assert_array_equal(table["real_contact_area"].ravel(), np.arange(8) * 200.0)
    assert table["position_px"].shape == (8, 10, 2)
    assert "real_contact_area (mm²)" in (tmp_path / "table.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
