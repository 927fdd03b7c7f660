"""Tests that recordings and streams follow the same rules: their numbers are equal."""

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import xarray as xr

import fingerflow
from bench.contact_grid import skin_in_contact
from fingerflow import player
from fingerflow.engines.engine import Array
from fingerflow.engines.native import NativeEngine
from fingerflow.kernels.library import is_present
from fingerflow.kernels.result_records import FrameContact, FrameEllipse, FrameFields, TrackedPoints
from fingerflow.pipeline.stages.preparation.inputs import Inputs
from fingerflow.synthetic import Press, write_recording
from fingerflow.tracker.frame_results import RESULTS, FrameResults, Seeding
from fingerflow.tracker.frame_tracker import PAGE, FrameOutcome, StreamTracker
from fingerflow.tracker.onset import Touches
from fingerflow.tracker.points import STREAM, join
from fingerflow.tracker.reseeding import ReseedingSchedule
from tests.silent import case as in_silence
from tests.silent.deviations import medians_of
from tests.small_trials import FRAMES, TRIALS, edit, recipe_of_trials, write_library_bundle, write_scene_of_bundle

pytestmark = pytest.mark.skipif(not is_present(), reason="the compiled library was not built or is turned off")


class Trial(NamedTuple):
    """A scene and the bundle that plays it."""

    scene: Path
    bundle: Path

    def play(self) -> Array:
        """Return the records of a stream of the scene."""
        results = self.scene.parent / "results"
        shutil.rmtree(results, ignore_errors=True)
        options = ["--scene", str(self.scene), "--output", str(results), "--page", "off", "--threads", "1"]
        assert player.main([str(self.bundle), *options]) == 0
        return np.array(player.read_results(results).records)


@pytest.fixture(scope="module")
def played(trials: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Trial]:
    """Return a press and a slide, by name."""
    folder = tmp_path_factory.mktemp("one_rule")
    bundle = write_library_bundle(folder / "bundle", recipe_of_trials())
    for name in ("press", "slide"):
        shutil.copytree(trials / name, folder / name)
    return {name: Trial(folder / name / "scene.toml", bundle) for name in ("press", "slide")}


@pytest.mark.parametrize("kind", ["press", "slide"])
def test_a_stream_equals_the_recording_bit_for_bit(
    played: dict[str, Trial], monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """A stream equals a recording bit for bit, medians of fields to rounding, as long as it has its first key frame; a
    recording has no other one. Standard deviations and errors of points are not compared in the key frame itself, in
    which a stream tracks the points and a recording knows their positions.

    The median divergence is compared in frames without a passing touch: a recording knows the end of such a touch and
    counts from the last touch.
    """
    made = Inputs.__init__

    def as_a_stream(inputs: Inputs, *arguments: Any, **named: Any) -> None:
        made(inputs, *arguments, **named)
        inputs.knowledge = STREAM

    monkeypatch.setattr(Inputs, "__init__", as_a_stream)
    recorded, records = fingerflow.process(played[kind].scene), played[kind].play()
    points, frames = recorded.sizes["point"], int((records["key_frame"] == 0).sum())
    assert frames > 25
    assert points == 150
    for name in ("real_contact_area", "gross_contact_area", "ellipse_center", "ellipse_semi_axes", "ellipse_angle"):
        np.testing.assert_array_equal(records[name], recorded[name].values.astype(np.float32), err_msg=name)
    np.testing.assert_array_equal(records["frame_status"], recorded["frame_status"])
    for name in ("position_px", "status", "in_contact"):
        np.testing.assert_array_equal(
            records[name][:frames], recorded[name].values[:frames].astype(records[name].dtype)
        )
    for name in ("position_std_px", "forward_backward_error"):
        np.testing.assert_array_equal(records[name][1:frames], recorded[name].values[1:frames], err_msg=name)
    calm = _without_passing_touch(recorded)[:frames]
    # A recording knows the reference positions of points that touch later, which changes the order of sums in fits.
    for name, rounding in (("median_divergence", 1e-6), ("global_displacement", 0)):
        medians = recorded[name].values.astype(np.float32)
        np.testing.assert_allclose(records[name][:frames][calm], medians[:frames][calm], rtol=0, atol=rounding)
        assert np.isfinite(medians[:frames][calm]).sum() > 25


@pytest.mark.parametrize(("count", "dark"), [(16, ()), (16, (8,)), (7, ())])
def test_contact_before_the_first_threshold_counts(
    played: dict[str, Trial], tmp_path: Path, count: int, dark: tuple[int, ...]
) -> None:
    """A slow camera sees a contact grow by much between two frames in which the first threshold is searched for: the
    frames between wait for it, so that areas and displacement count from the first frame with contact on. Where the
    second is dark or does not come, the threshold is that of the last frame between.
    """
    press = replace(TRIALS["press"], n_frames=16, frame_rate=60.0, frames_before_trigger=3)
    scene = write_scene_of_bundle(tmp_path / "slow", press)
    frames = np.load(scene.with_name("frames.npy"))
    frames[list(dark)] = 8
    np.save(scene.with_name("frames.npy"), frames[:count])
    edit(scene, ("threshold = 0.27\n", ""))
    recorded, records = fingerflow.process(scene), Trial(scene, played["press"].bundle).play()
    area = recorded["gross_contact_area"].values
    np.testing.assert_allclose(records["gross_contact_area"], area, atol=0.02 * np.nanmax(area))
    for name in ("median_divergence", "global_displacement"):
        off = np.abs(records[name] - recorded[name].values) / records[f"{name}_std"]
        assert np.isfinite(off).sum() > 6 or count < 16
        assert (off[np.isfinite(off)] < 1).all()


@pytest.mark.parametrize("before", ["tracked", "lost"])
def test_points_seeded_in_contact_take_over_the_displacement(
    played: dict[str, Trial], monkeypatch: pytest.MonkeyPatch, before: str
) -> None:
    """Points that are seeded again on skin in contact count from the onset of the points before them; where these are
    lost, that skin and its medians are NaN, though points be seeded again.
    """
    begin = FrameResults._begin

    def begin_without(results: FrameResults, seeding: Seeding, covered: Array) -> None:
        begin(results, seeding._replace(before=None) if results._frames < 40 else seeding, covered)
        results._seeding = seeding

    monkeypatch.setattr(ReseedingSchedule, "update", lambda *frame: PAGE if frame[2] in (36, 42) else "")
    if before == "lost":
        monkeypatch.setattr(FrameResults, "_begin", begin_without)
    records = played["press"].play()
    frames = np.arange(40, FRAMES)
    assert records["restart"][frames].min() == 2
    median, stated = (1000 * records[f"median_divergence{suffix}"][frames] for suffix in ("", "_std"))
    if before == "lost":
        assert np.isnan(median).all()
        return
    recorded = 1000 * fingerflow.process(played["press"].scene)["median_divergence"].values[frames]
    assert recorded[0] > 20  # um/mm, by which a count that starts at the seeding would be off
    assert (np.abs(median - recorded) < 2 * stated).mean() > 0.95


@pytest.mark.parametrize("kind", ["press", "slide"])
def test_results_do_not_depend_on_the_number_of_frames_at_once(
    played: dict[str, Trial], monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """Frames that wait are measured at once; their results are those of single frames, to rounding of float32."""
    seen: list[tuple[FrameResults, Seeding, FrameContact, TrackedPoints, Array]] = []
    compute = FrameResults.compute

    def keep(results: FrameResults, *frame: Any) -> dict[str, Array]:
        seen.append((results, *frame))
        return compute(results, *frame)

    monkeypatch.setattr(FrameResults, "compute", keep)
    monkeypatch.setattr("fingerflow.player.stream_player._AT_ONCE", 1)
    played[kind].play()
    monkeypatch.undo()
    results, seeding, *_ = max(seen, key=lambda frame: sum(frame[1] is other[1] for other in seen))
    frames = [list(frame[2:]) for frame in seen if frame[1] is seeding]
    for frame in frames[::3]:  # touches end, and others begin
        frame[0] = frame[0]._replace(density_margin=frame[0].density_margin - 0.2)

    def computed(at_once: int) -> dict[str, Array]:
        again = FrameResults(results._engine, results._geometry)
        parts = [zip(*frames[first : first + at_once], strict=True) for first in range(0, len(frames), at_once)]
        values = [
            again.compute(seeding, join(contact), join(points), np.concatenate(pull)) for contact, points, pull in parts
        ]
        return {name: np.concatenate([part[name] for part in values]) for name in RESULTS}

    single = computed(1)
    assert np.isfinite(single["median_divergence_std"]).sum() > 20
    for at_once in (2, 4, 7):
        several = computed(at_once)
        for name in RESULTS:
            np.testing.assert_allclose(several[name], single[name], rtol=2e-5, atol=1e-6, err_msg=f"{name} {at_once}")
    # Exported graphs take one frame.
    sizes: list[int] = []
    fields = NativeEngine.fields

    def count(engine: NativeEngine, reference: Array, displacement: Array, *more: Any) -> FrameFields:
        sizes.append(len(displacement))
        return fields(engine, reference, displacement, *more)

    monkeypatch.setattr(NativeEngine, "fixed", True)
    monkeypatch.setattr(NativeEngine, "fields", count)
    graphs = computed(4)
    assert set(sizes) == {1}
    for name in RESULTS:
        np.testing.assert_array_equal(graphs[name], single[name], err_msg=name)


def test_a_contact_that_has_just_begun_is_not_named_faint(
    played: dict[str, Trial], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clean press gives no warning of a faint rim in any frame; at 0.3 to 0.7 mm2, too few ridges touch to tell."""
    compute, warnings = StreamTracker.compute_results, list[str]()

    def compute_and_check(tracker: StreamTracker, outcomes: Sequence[FrameOutcome]) -> dict[str, Array]:
        results = compute(tracker, outcomes)
        warnings.extend(tracker.check_faint_rim())
        return results

    monkeypatch.setattr(StreamTracker, "compute_results", compute_and_check)
    monkeypatch.setattr("fingerflow.player.stream_player._AT_ONCE", 1)
    played["press"].play()
    assert not warnings


def test_what_a_wide_median_takes_is_within_the_deviation(played: dict[str, Trial], tmp_path: Path) -> None:
    """The share that a median of 9 px may take is added to the deviation in streams too, which was 0.08 mm2 without."""
    press, recipe = played["press"], recipe_of_trials()
    bundle = write_library_bundle(tmp_path, replace(recipe, contact=replace(recipe.contact, median_px=9)))
    taken = press.play()["real_contact_area"][-1] - press._replace(bundle=bundle).play()["real_contact_area"][-1]
    assert 0.2 < taken < 2 * fingerflow.open_stream(press.scene.parent / "results")["real_contact_area_std"][-1]


def _without_passing_touch(recorded: xr.Dataset) -> Array:
    """Return for each frame (F,) whether every point in contact has its final reference position."""
    position, covered = recorded["position"].values, recorded["in_contact"].values
    touches = Touches(recorded.sizes["point"])
    border = FrameEllipse(*(recorded[f"ellipse_{name}"].values for name in FrameEllipse._fields))
    seen = touches.add_frames(np.arange(len(position)), covered, position, np.zeros(covered.shape, np.float32), border)
    return ~(seen.touching & (seen.position != recorded["reference_position"].values).any(-1)).any(1)


def test_deviations_hold_in_a_stream_of_a_slow_camera(tmp_path: Path) -> None:
    """The contact of a press grows by half from one frame to the next."""
    press = Press(n_frames=9, frame_rate=15.0, frames_before_trigger=1, contact_time=0.05)
    write_recording(tmp_path / "press", press)
    result = in_silence.played(tmp_path / "press" / "scene.toml")
    for frame in range(3, 9):
        true = medians_of(press.truth.gradient(skin_in_contact(press, frame, 0.1), frame))
        for name in ("divergence", "curl"):
            median, deviation = (result[f"median_{name}{of}"].values[frame] for of in ("", "_std"))
            assert abs(median - true[name]) < 2.5 * deviation
