"""Tests of bad frames in a stream: a press is played with each kind of bad frame, and `process` is run on it.

`python -m tests.silent frames` does the same with a slide and more faults.
"""

import shutil
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import fingerflow
from fingerflow import player
from fingerflow.engines.engine import Array
from fingerflow.kernels.library import is_present
from fingerflow.schema.variables import FRAME_STATUS, TRACK_STATUS, USABLE
from tests import small_trials

pytestmark = pytest.mark.skipif(not is_present(), reason="the compiled library was not built or is turned off")

ALONE = [3, 9, 17, 30, 41, 49, 55, 64]  # one of each kind, at an evaluation of the templates, and in full contact


class Small(NamedTuple):
    """A press, its bundle and frames, and the results of a stream of its clean recording."""

    folder: Path
    bundle: Path
    frames: Array
    clean: player.StreamResults

    def play(self, frames: Array, *arguments: str) -> player.StreamResults:
        np.save(self.folder / "played.npy", frames)
        shutil.rmtree(self.folder / "out", ignore_errors=True)
        options = ["--scene", str(self.folder / "trial" / "scene.toml"), "--source", str(self.folder / "played.npy")]
        options += ["--output", str(self.folder / "out"), "--page", "off", "--threads", "1"]
        assert player.main([str(self.bundle), *options, *arguments]) == 0
        found = player.read_results(self.folder / "out")
        return found._replace(records=np.array(found.records))


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Small:
    folder = tmp_path_factory.mktemp("bad_frames")
    bundle = small_trials.write_library_bundle(folder / "bundle", small_trials.recipe_of_trials())
    small_trials.write_trial(folder / "trial")
    frames = np.load(folder / "trial" / "frames.npy")
    unplayed = Small(folder, bundle, frames, player.StreamResults(frames[:0], {}, []))
    return unplayed._replace(clean=unplayed.play(frames))


def _status_of(records: Array) -> dict[int, str]:
    return {int(k): FRAME_STATUS[records["frame_status"][k]] for k in np.flatnonzero(records["frame_status"])}


def _assert_unknown(records: Array, places: list[int]) -> None:
    """Assert that the measured values of these frames are NaN, and that the status of each point gives the reason."""
    told = {"time", "latency"}
    for name in records.dtype.names or ():
        if records.dtype[name].base.kind == "f" and name not in told:
            assert np.isnan(records[name][places]).all(), name
    assert (records["status"][places] == TRACK_STATUS.index("frame_not_usable")).all()
    assert not records["in_contact"][places].any()


def _assert_others_as_before(small: Small, records: Array, places: list[int]) -> None:
    """Assert that all other frames of a press have the values of the clean run.

    Areas are equal to the last digit, because the threshold is given and the pictures are the same. Points and fields
    depend on earlier frames: templates are evaluated, and onsets seen, in the next usable frame.

    Tolerance of points: three standard deviations of the difference of two estimates (sqrt(2) of the stated one), plus
    0.01 px for prediction and renewal (tests/test_engines_agree.py); 99 in 100 lie within the 0.01 px alone. Of the
    median divergence: 2.5 um/mm, less than 2.3 of its stated deviations (docs/accuracy.md).
    """
    good, clean = np.setdiff1d(np.arange(small_trials.FRAMES), places), small.clean.records
    areas = "real_contact_area", "gross_contact_area", "contact_threshold", "ellipse_center", "ellipse_angle"
    for name in (*areas, "status", "slip_flag"):
        np.testing.assert_array_equal(records[name][good], clean[name][good], err_msg=name)
    off = np.abs(records["position_px"][good] - clean["position_px"][good])
    known = np.isfinite(clean["position_px"][good])
    np.testing.assert_array_equal(np.isfinite(off), known)
    deviation = np.broadcast_to(clean["position_std_px"][good][..., None], off.shape)
    assert (off[known] <= 0.01 + 3 * 2**0.5 * deviation[known]).all()
    assert np.mean(off[known] > 0.01) < 0.01
    np.testing.assert_allclose(
        records["median_divergence"][good], clean["median_divergence"][good], rtol=0, atol=2.5e-3
    )


def test_a_bad_frame_counts_in_no_number_live_or_recorded(small: Small) -> None:
    """One bad frame of each kind: its values are NaN with the reason as status, all other frames have the values of the
    clean run, and `process` of the same recording finds the same frames, reasons, areas and median divergence.
    """
    assert _status_of(small.clean.records) == {}
    frames = small.frames.copy()
    for k, (spoil, _) in zip(ALONE, small_trials.SPOILED.values(), strict=True):
        frames[k] = spoil(frames[k])
    played = small.play(frames)
    live = played.records
    assert _status_of(live) == {k: status for k, (_, status) in zip(ALONE, small_trials.SPOILED.values(), strict=True)}
    _assert_unknown(live, ALONE)
    _assert_others_as_before(small, live, ALONE)
    assert [event["frame"] for event in played.events if event["event"] == "restart"] == [0]
    assert [event["frame"] for event in played.events if event["event"] == "not_usable"] == ALONE
    stream = fingerflow.open_stream(small.folder / "out")
    shutil.copytree(small.folder / "trial", small.folder / "damaged")
    np.save(small.folder / "damaged" / "frames.npy", frames)
    recorded = fingerflow.process(small.folder / "damaged" / "scene.toml")
    np.testing.assert_array_equal(live["frame_status"], recorded["frame_status"])
    assert stream["frame_status"].attrs == recorded["frame_status"].attrs
    for name in ("real_contact_area", "gross_contact_area"):
        np.testing.assert_allclose(live[name], recorded[name], rtol=2e-3)
    np.testing.assert_allclose(live["median_divergence"], recorded["median_divergence"], rtol=0, atol=1.7e-3)
    for result in (stream, recorded):
        np.testing.assert_array_equal(np.flatnonzero(np.isnan(result["tracked_share"])), ALONE)


def test_a_measured_threshold_is_not_that_of_a_bad_frame(small: Small) -> None:
    """The threshold is not measured in a bad frame, black or with a dim contact view, but in a later frame. In contacts
    of more than 4 mm² the threshold is that of the clean run to 0.007 of the light, the scatter between contacts of
    different size, and the real contact area to 2 %.
    """
    scene_file = small.folder / "trial" / "scene.toml"
    text = scene_file.read_text()
    scene_file.write_text(text.replace("threshold = 0.27\n", ""))
    try:
        clean = small.play(small.frames)
        frames, places = small.frames.copy(), []
        for number, event in enumerate(one for one in clean.events if one["event"] == "threshold"):
            places.append(event["frame"])
            spoil, _ = small_trials.SPOILED["black" if number % 2 else "dim contact view"]
            frames[places[-1]] = spoil(frames[places[-1]])
        played = small.play(frames)
        small.play(frames[-2:])
    finally:
        scene_file.write_text(text)
    # The threshold of the first frame applies at once to both, though no later frame has begun with it.
    assert "showed a contact" not in (small.folder / "out" / "summary.json").read_text()
    assert len(places) > 3
    assert sorted(_status_of(played.records)) == places
    measured = [event for event in played.events if event["event"] == "threshold"]
    assert not set(places) & {event["frame"] for event in measured}
    large = (clean.records["gross_contact_area"] > 4) & (played.records["frame_status"] == USABLE)
    assert large.sum() > 30
    np.testing.assert_allclose(
        played.records["contact_threshold"][large], clean.records["contact_threshold"][large], rtol=0, atol=7e-3
    )
    np.testing.assert_allclose(
        played.records["real_contact_area"][large], clean.records["real_contact_area"][large], rtol=0.02
    )


def test_a_stream_without_usable_frames_or_contact_says_so(small: Small, capsys: pytest.CaptureFixture[str]) -> None:
    """The player warns if all frames are dark, and if no frame shows a contact. If lines of the picture are lost from
    the first frame on, frames count from the fourth on, as the camera may have lost them for good.
    """
    small.play(np.full_like(small.frames[:8], 8))
    assert "no frame could be measured (8 dark)" in capsys.readouterr().out
    lost = np.stack([*map(small_trials.SPOILED["lines lost"][0], small.frames[:8])])
    assert [*_status_of(small.play(lost).records)] == [0, 1, 2]
    glass = np.load(small.folder / "trial" / "empty.npy")
    small.play(np.resize(glass, small.frames[:8].shape).astype(np.uint8))
    assert "no frame showed a contact" in capsys.readouterr().out


def test_steps_of_the_area_are_said(small: Small, caplog: pytest.LogCaptureFixture) -> None:
    """A stream warns of missing frames, of light that falls to half and stays there, and of a contact that is there
    when it begins, as a recording does.
    """
    dim = small.frames.copy()
    dim[60:, :, small_trials.WIDTH :] //= 2
    for frames, words in (
        (small.frames, ""),
        (np.delete(small.frames, np.s_[30:45], 0), "frames may be missing"),
        (dim, "light has changed"),
        (small.frames[40:], "begins in contact"),
    ):
        caplog.clear()
        small.play(frames)
        steps = [line for line in caplog.messages if "the gross contact area" in line or "in contact:" in line]
        assert words in str(steps)
        assert bool(steps) == bool(words)


def test_skin_that_moves_in_the_air_begins_a_new_touch(small: Small) -> None:
    """Displacement and strain of a finger that lands with skin 3 px aside count from there."""
    topography, contact = np.split(small.frames, [small_trials.WIDTH], axis=2)
    aside = np.concatenate([np.roll(topography, 3, axis=2), contact], axis=2)
    again = np.concatenate([small.frames, small.frames[::-1], aside])
    again ^= np.random.default_rng(0).integers(0, 2, again.shape, again.dtype)
    records = small.play(again).records
    first, second = records[len(small.frames) - 1], records[-1]
    for name in ("global_displacement", "median_divergence"):
        deviation = np.hypot(first[f"{name}_std"], second[f"{name}_std"])
        assert abs(second[name] - first[name]) < 2 * deviation, name
    assert second["global_displacement"] > 5 * second["global_displacement_std"]
