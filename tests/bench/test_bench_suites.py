"""Tests of every suite in its quick form: its rows are complete, and accuracy is what the README states. Times are not
tested.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

from bench import dic_codes, timing
from bench.rows import Row, number
from bench.suites import curved, flow, image_ops, speed_against_error, tracking
from fingerflow.kernels import tensors as kernels

pytestmark = pytest.mark.long


@pytest.fixture(autouse=True)
def _few_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the timing of the suites, because times are not tested."""

    def once(
        candidates: dict[str, Callable[[], object]], peer: str, rounds: int, clock: object = None
    ) -> dict[str, timing.Timing]:
        assert peer in candidates
        assert rounds >= 2
        return {name: timing.Timing(1.0, 1.0, 1.0, 1.0) for name in candidates}

    for suite in (flow, image_ops, speed_against_error, tracking):
        monkeypatch.setattr(suite, "time_in_turns", once)


def one(rows: Sequence[Row], **wanted: object) -> Row:
    (row,) = [row for row in rows if all(row[name] == value for name, value in wanted.items())]
    return row


def test_tracking() -> None:
    """The error is at the bound (0.8 to 1.15 times; 150 points tell it to 5 %) at any noise; OpenCV is not at the bound
    where noise is low.
    """
    rows = tracking.run(quick=True)
    still = one(rows, noise=0, start="whole pixel", shift=0.0, tracker="fingerflow")
    assert still["rms_px"] == 0
    assert still["over_bound"] is None
    for noise in (0, 2):
        for start in ("whole pixel", "anywhere"):
            ours = one(rows, noise=noise, start=start, shift="all", tracker="fingerflow")
            theirs = one(rows, noise=noise, start=start, shift="all", tracker="opencv")
            assert 0.8 < number(ours, "over_bound") < 1.15
            assert number(ours, "over_bound") < number(theirs, "over_bound") + 0.05
            assert ours["accepted"] == theirs["accepted"] == 1
            assert "ms" in ours
    assert number(one(rows, noise=0, start="whole pixel", shift="all", tracker="opencv"), "over_bound") > 2


def test_flow() -> None:
    """The error is below 0.015 px on ridges in all directions. On ridges in one direction, as in this part of the
    whorl, motion along the ridges is smoothed over a longer distance: this error is no noise and not in the stated
    deviation.
    """
    rows = flow.run(quick=True)
    for scene, error, z in (("ridges", 0.015, 1.25), ("whorl", 0.03, 2.3)):
        peer = one(rows, scene=scene, way="opencv Farneback")
        for way in ("fingerflow, cold", "fingerflow, warm"):
            row = one(rows, scene=scene, way=way)
            assert number(row, "epe_px") < min(error, 0.7 * number(peer, "epe_px"))
            assert number(row, "div") < 0.6 * number(peer, "div")
        assert 0.8 < number(one(rows, scene=scene, way="fingerflow, cold"), "z") < z


def test_curved() -> None:
    """On a wave of 100 px the error is less than 0.45 times OpenCV's; there and in uniform displacement it is that
    stated.
    """
    rows = curved.run(quick=True)
    ours, peer = (one(rows, field="K 100, A 0.5", tracker=tracker) for tracker in ("fingerflow", "opencv"))
    assert number(ours, "rms_px") < 0.45 * number(peer, "rms_px")
    for field, most in (("K 50, A 0.1", 0.0168), ("K 100, A 0.5", 0.0138), ("star", 0.0193)):  # 3 % over measured
        assert number(one(rows, field=field, tracker="fingerflow"), "rms_px") < most
    assert 0.75 < number(ours, "z") < 1.3
    assert 0.85 < number(one(rows, field="uniform", tracker="fingerflow"), "z") < 1.15


def test_speed_against_error(tmp_path: Path) -> None:
    """Errors are at the bound for all trackers but kornia; eight frames in one call have the error of one frame in a
    call; both DIC codes have their rows.
    """
    rows = speed_against_error.run(quick=True)
    followed = [row for row in rows if row["tracker"] in speed_against_error.FOLLOWERS]
    assert len(followed) == 4
    assert len(rows) == 2 * len(speed_against_error.TRACKERS) + len(["kornia"]) + len(followed) + len(dic_codes.CODES)
    for row in rows:
        if "left_out" not in row:
            assert 0.75 < number(row, "over_bound") < (2 if row["tracker"] == "kornia" else 1.4), row
            assert row["wrong"] == 0 or row["tracker"] == "OpenCV, 4 levels", row
    if kernels.serve():
        for window in (11, 25):
            recorded, live = (one(followed, window_px=window, tracker=name) for name in speed_against_error.FOLLOWERS)
            assert recorded["rms_px"] == live["rms_px"]
            assert recorded["accepted"] == live["accepted"] == 1
    speed_against_error.draw(rows, tmp_path / "figure.png")
    pixels = plt.imread(tmp_path / "figure.png")
    assert pixels.shape[0] > 600
    assert 0.01 < (pixels[..., :3].min(-1) < 0.9).mean() < 0.3  # curves on a white ground


def test_image_ops() -> None:
    """Medians and thresholds are equal in all libraries. Corners differ at the border only, and contact in few pixels:
    a limit in counts rounds at other values than levels of a byte.
    """
    rows = image_ops.run(quick=True)
    same = {(row["operation"], row["way"]): row["same"] for row in rows if row["way"] != "fingerflow"}
    assert len(same) == 18
    for (operation, _), value in same.items():
        assert value >= (0.8 if "corners" in operation else 0.998 if "contact" in operation else 1), same
