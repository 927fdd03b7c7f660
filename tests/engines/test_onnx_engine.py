"""Tests of the engine that runs a bundle by ONNX Runtime against the engine of torch: both give the same numbers,
method by method.
"""

import dataclasses
import logging
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import onnx
import pytest
import torch

from fingerflow.engines import choice, sessions
from fingerflow.engines import engine as arrays
from fingerflow.engines.bundle import Bundle, load_bundle
from fingerflow.engines.check import check_engine
from fingerflow.engines.contact_view import glass_light
from fingerflow.engines.engine import Array, noise_of
from fingerflow.engines.graph_engine import GraphEngine
from fingerflow.engines.sessions import GraphSession, installed_providers
from fingerflow.engines.torch import TorchEngine
from fingerflow.errors import FingerflowError
from fingerflow.kernels.tracking_limits import TrackStatus
from tests.small_trials import HEIGHT, POINTS, TRIALS, WIDTH

Found = arrays.TrackedPoints

PRESS = TRIALS["press"]
KEY, FRAME = 60, 63
MM = 0.02


class Both(NamedTuple):
    """Results of both engines."""

    onnx: Any
    torch: Any


@pytest.fixture(scope="module")
def bundle(bundle_of_trials: Path) -> Bundle:
    return load_bundle(bundle_of_trials)


@pytest.fixture(scope="module")
def engines(bundle: Bundle) -> Both:
    return Both(choice.open_onnx(bundle), TorchEngine(bundle.engine_settings, torch.device("cpu")))


def view(name: str, frame: int | str) -> Array:
    """Return a view (1, H, W) of uint8 of a frame of the press, of the press without contact ("empty"), of noise
    ("noise"), or of ridges two pixels wide that cover 15 % of a contact ("thin").
    """
    if frame == "noise":
        random = np.random.default_rng(1)
        return random.integers(0, 256, (1, HEIGHT, WIDTH)).astype(np.uint8)
    if frame == "thin":
        y, x = np.mgrid[:HEIGHT, :WIDTH]
        across = np.abs((x + 0.3 * y) % 14 - 7) - 1.05
        inside = np.hypot((x - WIDTH / 2) / 80, (y - HEIGHT / 2) / 60) < 1
        glass = PRESS.views["contact"].crop(PRESS.empty())
        return (glass * (1 - inside * (0.1 + 0.25 * (1 - np.tanh(2 * across)))))[None].astype(np.uint8)
    picture = PRESS.empty() if frame == "empty" else PRESS.render(int(frame))
    return PRESS.views[name].crop(picture)[None].astype(np.uint8)


@pytest.fixture(scope="module")
def points(engines: Both) -> Array:
    """Return points (POINTS - 3, 2) px as they are seeded; every ninth is NaN."""
    image = engines.onnx.images(view("topography", KEY))
    found = engines.onnx.detect(image, np.ones((HEIGHT, WIDTH), bool), POINTS)[:-3].copy()
    found[::9] = np.nan
    return found


def both(engines: Both, call: Any) -> Iterator[tuple[Any, Any]]:
    """Yield pairs of the fields that a function of an engine returns, one of each engine."""
    return zip(*(call(one) for one in engines), strict=True)


def keyed(engine: Any, points: Array) -> Any:
    return engine.prepare(engine.images(view("topography", KEY)), points)


def same(ours: Array | None, theirs: Array | None, atol: float = 1e-5, rtol: float = 1e-5) -> None:
    if ours is None or theirs is None:
        assert ours is theirs
    else:
        assert ours.shape == theirs.shape
        np.testing.assert_allclose(ours, theirs, rtol=rtol, atol=atol)


def same_found(ours: Found, theirs: Found, points: Array, rtol: float = 1e-3, px: float = 1e-4) -> None:
    """Assert that both engines find the same points.

    Float32 positions of hundreds of px have steps of 3e-5 px. Statuses of lost points are not compared, because they
    may depend on the last digit.
    """
    tracked = theirs.status == TrackStatus.TRACKED
    np.testing.assert_array_equal(ours.status == TrackStatus.TRACKED, tracked)
    same(ours.points, theirs.points, px)
    same(ours.covariance, theirs.covariance, 1e-6, rtol)
    same(ours.error[tracked], theirs.error[tracked], 1e-4, rtol)
    same(ours.estimate[tracked], theirs.estimate[tracked], px)
    assert np.isnan(ours.points[:, np.isnan(points[:, 0])]).all()


@pytest.mark.parametrize(("frame", "threshold"), [(FRAME, 0.27), (FRAME, np.nan), ("noise", 0.27), ("thin", 0.27)])
def test_contact(engines: Both, frame: int | str, threshold: float) -> None:
    def contact(engine: Any) -> Any:
        glass, dark = (PRESS.views["contact"].crop(one) for one in (PRESS.empty(), PRESS.dark()))
        light = glass_light(glass, dark)
        images = engine.images(view("contact", frame))
        found = engine.contact(images, light, np.array([threshold], np.float32))
        return *found, engine.contact(images, light).threshold

    *others, (measured, expected) = both(engines, contact)
    for ours, theirs in (*others, (measured, expected)):
        same(ours, theirs, 1e-4)
    assert np.isfinite(measured).all() == (frame in (FRAME, "thin"))


def test_light_is_none_outside_a_mask_and_darkness_may_be_unknown(engines: Both) -> None:
    light = glass_light(PRESS.views["contact"].crop(PRESS.empty()), None)
    light[0][..., WIDTH // 2 :] = 0

    def areas(engine: Any) -> Any:
        return engine.contact(engine.images(view("contact", FRAME)), light, np.array([0.27], np.float32))[1:3]

    for ours, theirs in both(engines, areas):
        same(ours, theirs)
        assert ours > 0


@pytest.mark.parametrize("frame", [KEY, "empty"])
def test_noise_and_points_worth_tracking(engines: Both, frame: int | str) -> None:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[30:150, 40:200] = True

    def seeded(engine: Any) -> Any:
        image = engine.images(view("topography", frame))
        return np.array(noise_of(engine, image)), engine.detect(image, mask, POINTS)

    (our_noise, noise), (ours, theirs) = both(engines, seeded)
    same(our_noise, noise)
    # Corners of nearly equal strength may change their order.
    places, others = ({tuple(point) for point in one.tolist()} for one in (ours, theirs))
    assert len(places ^ others) <= 0.02 * len(others)


@pytest.mark.parametrize(("frame", "off"), [(FRAME, 0.3), (FRAME, 3.0), ("empty", 0.3)])
def test_points_found(engines: Both, points: Array, frame: int | str, off: float) -> None:
    """Both engines find the same points, also from a guess further away than the reach of the tracker, and for a few or
    most of the points only.
    """

    def follow(engine: Any, rows: Array | None) -> arrays.Followed:
        templates = keyed(engine, points)
        start = points if rows is None else points[rows]
        place, speed = start + np.float32(off), np.full_like(start, -0.1)
        return engine.track(templates, engine.images(view("topography", frame)), place, speed, rows)

    for rows in (None, np.arange(0, len(points), 3), np.arange(1, len(points))):
        ours, theirs = (follow(engine, rows) for engine in engines)
        # Points that match the noise of an empty frame by chance depend on differences of nearly equal sums.
        rtol, px = (1e-2, 1e-3) if frame == "empty" else (1e-3, 1e-4)
        same_found(ours.found, theirs.found, points if rows is None else points[rows], rtol, px)
        tracked = theirs.found.status[0] == TrackStatus.TRACKED
        given = np.isfinite(points if rows is None else points[rows])[:, 0]
        assert (tracked[given].mean() > 0.9) == (frame == FRAME)
        same(ours.place[tracked], theirs.place[tracked], px)
        same(ours.speed[tracked], theirs.speed[tracked], px)
        assert np.isfinite(ours.place[given]).all()


@pytest.mark.parametrize("name", ["track_few", "windows"])
def test_a_few_points_keep_their_order(name: str) -> None:
    """Graphs with a fixed and with a free number of points return the outputs of all points and none of the padding."""

    class Session:
        any_number = True

        def __call__(self, inputs: dict[str, Array]) -> dict[str, Array]:
            return {"same": inputs["points"]}

    settings: Any = SimpleNamespace(cell_px=8)
    engine = GraphEngine({"fit": Session(), name: Session()}, settings, POINTS)
    for count in (1, 32, 33, 49, 100):
        given = np.arange(2 * count, dtype=np.float32).reshape(1, count, 2)
        np.testing.assert_array_equal(engine._in_pieces(name, {"points": given}, {})["same"], given)


def keyed_and_tracked(engine: Any, points: Array) -> tuple[Any, Callable[[], Any]]:
    """Return templates of points, and a function that tracks them in a later frame with the templates there are."""
    templates, image = keyed(engine, points), engine.images(view("topography", FRAME))
    return templates, lambda: engine.track(templates, image, points, np.zeros_like(points)).found


def test_templates_are_updated_for_a_deformation(engines: Both, points: Array) -> None:
    """Both engines update templates for a deformation of the skin alike, of more points than one call of the graph
    takes.
    """
    random = np.random.default_rng(0)
    warp = (np.eye(2) + 0.03 * random.normal(size=(len(points), 2, 2))).astype(np.float32)
    rows = np.arange(0, len(points), 2)[:70]

    def updated(engine: Any) -> Any:
        templates, track = keyed_and_tracked(engine, points)
        before = track()
        templates.update(rows, engine.prepare(templates, points[rows], warp[rows]))
        return before, track(), templates.numbers

    (_, _), (ours, theirs), (our_numbers, numbers) = both(engines, updated)
    same_found(ours, theirs, points)
    (unchanged, _), *_ = both(engines, updated)
    assert not np.array_equal(unchanged.points, ours.points, equal_nan=True)
    known = np.isfinite(points[:, 0])
    our_numbers, numbers = (np.delete(one, range(5, 7), 1) for one in (our_numbers, numbers))  # sums near 0
    scale = np.abs(numbers[known]).max(0)
    same(our_numbers[known] / scale, numbers[known] / scale, 1e-4)


def test_templates_are_updated_in_the_memory_of_a_provider(
    bundle: Bundle, points: Array, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Templates are updated in a provider's own memory, for which a copy stands in here."""
    engine = choice.open_onnx(bundle)
    of_array = GraphSession.kept
    monkeypatch.setattr(GraphSession, "kept", lambda session, name, array: of_array(session, name, array.copy()))
    monkeypatch.setattr(sessions, "CPU", "the processor has no part in it")
    templates, track = keyed_and_tracked(engine, points)
    before = track().points
    rows = np.flatnonzero(np.isfinite(before[0, :, 0]))[:20]
    templates.update(rows, engine.prepare(templates, points[rows] + np.float32(0.5)))
    moved = track().points
    np.testing.assert_allclose((moved - before)[0, rows], 0.5, atol=0.1)


def test_positions_corrected_and_judged(engines: Both, points: Array) -> None:
    rows = np.flatnonzero(np.isfinite(points[:, 0]))[5::40]

    def corrected(engine: Any) -> Any:
        templates = keyed(engine, points)
        found = engine.track(templates, engine.images(view("topography", FRAME)), points, np.zeros_like(points)).found
        found.points[0, rows] += 3  # away from their neighbours
        inverse_warp = np.broadcast_to(np.eye(2, dtype=np.float32) * 1.01, (len(points), 2, 2)).copy()
        result = engine.correct(points, found, templates.numbers, inverse_warp)
        return result.found.points, result.found.covariance, *result[1:], result.found.status

    for ours, theirs in both(engines, corrected):
        same(ours, theirs, 1e-4)
    assert (corrected(engines.onnx)[-1][0, rows] == TrackStatus.OFF_NEIGHBOURS).any()


def test_points_searched_for(engines: Both, points: Array) -> None:
    guess = points + np.float32(5)

    def search(engine: Any) -> Any:
        return engine.search(keyed(engine, points), engine.images(view("topography", FRAME)), points, guess)

    (ours, theirs), (returns, expected) = both(engines, search)
    same(ours, theirs, 1e-3)
    np.testing.assert_array_equal(returns, expected)
    assert returns.mean() > 0.5


@pytest.mark.parametrize("contact", [True, False])
def test_fields(engines: Both, points: Array, contact: bool) -> None:
    reference = (MM * points).astype(np.float32)
    moved = 0.05 * (reference - reference[1]) + 0.01 * np.sin(reference[:, ::-1])
    moved[4] = np.nan
    middle = np.array([[MM * WIDTH / 2, MM * HEIGHT / 2]], np.float32)
    ellipse = arrays.FrameEllipse(middle, middle * np.float32(0.5), np.array([0.1], np.float32))
    if not contact:
        ellipse = arrays.FrameEllipse(*(one * np.float32(np.nan) for one in ellipse))
    among = np.zeros((1, len(points)), bool)
    among[0, ::5] = True
    own = np.where(among[..., None, None], np.float32(0.02), np.float32(np.nan)).repeat(2, 2).repeat(2, 3)
    for entered in (None, arrays.EnteredPoints(among, own, None)):
        given = (reference, moved[None].astype(np.float32), ellipse, None, entered)
        ours, theirs = (engine.fields(*given) for engine in engines)
        for one, other in zip(ours, theirs, strict=True):
            same(one, other)
        assert np.isfinite(ours.median).all() == contact
        assert np.isfinite(ours.divergence[:, ~np.isnan(moved[:, 0])]).mean() > 0.8


def test_frames_in_two_threads_are_those_one_after_the_other(engines: Both, points: Array) -> None:
    engine = engines.onnx
    templates = keyed(engine, points)
    light = glass_light(PRESS.views["contact"].crop(PRESS.empty()), None)

    def compute(frame: int) -> list[Array]:
        contact = engine.contact(engine.images(view("contact", frame)), light, np.array([0.27], np.float32))
        image = engine.images(view("topography", frame))
        found = engine.track(templates, image, points, np.zeros_like(points)).found
        inverse_warp = np.broadcast_to(np.eye(2, dtype=np.float32), (len(points), 2, 2))
        corrected = engine.correct(points, found, templates.numbers, inverse_warp).found
        return [one.copy() for one in (*contact, *found, *corrected)]

    frames = [*range(KEY, KEY + 6)] * 2
    alone = [compute(frame) for frame in frames]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(compute, frames))
    for one, other in zip(alone, together, strict=True):
        for ours, theirs in zip(one, other, strict=True):
            np.testing.assert_array_equal(ours, theirs)
    assert not np.array_equal(alone[0][1], alone[5][1])


def test_what_the_graphs_do_not_take_is_named(engines: Both) -> None:
    engine = engines.onnx
    frame = view("topography", KEY)
    for wrong in (np.concatenate((frame, frame)), frame[:, 1:], frame.astype(np.uint16)):
        with pytest.raises(ValueError, match=f"topography_view is {wrong.dtype} .*, the graph takes uint8"):
            noise_of(engine, engine.images(wrong))
    with pytest.raises(ValueError, match="exported for 150"):
        engine.detect(engine.images(frame), np.ones((HEIGHT, WIDTH), bool), POINTS - 1)
    with pytest.raises(FingerflowError, match=r"151 points are given, the bundle was exported for 150"):
        engine.prepare(engine.images(frame), np.zeros((POINTS + 1, 2), np.float32))


def test_damaged_numbers_are_named(engines: Both, bundle: Bundle) -> None:
    for expected in ({}, {**bundle.expected, "numbers": None}, {**bundle.expected, "points": "many"}):
        with pytest.raises(FingerflowError, match="'expected'"):
            check_engine(engines.onnx, expected)


def test_a_provider_that_is_not_there_is_named(bundle: Bundle) -> None:
    with pytest.raises(FingerflowError, match=r"provider 'tpu' is not installed here; there are: .*cpu"):
        choice.open_onnx(bundle, "tpu")
    assert list(installed_providers())[-1] == "cpu"


@pytest.mark.filterwarnings("ignore:Specified provider")
def test_a_provider_with_other_numbers_is_passed_over(
    bundle: Bundle, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A provider that cannot be loaded or gives other numbers than the bundle is skipped with a warning; if the
    provider was asked for by name, this is an error.
    """
    full = installed_providers()["cpu"]
    monkeypatch.setattr(
        sessions, "installed_providers", lambda: {"broken": "NoExecutionProvider", "odd": full, "cpu": full}
    )
    wrong = [True, False, True]

    def check(engine: GraphEngine, expected: Any) -> None:
        if wrong.pop(0):
            raise FingerflowError("its numbers are not those of the bundle")

    monkeypatch.setattr(choice, "check_engine", check)
    with caplog.at_level(logging.WARNING):
        assert choice.engine_of_stream(bundle, "onnx").described == "onnx (CPUExecutionProvider)"
    assert [message.split(" does not serve")[0] for message in caplog.messages] == ["provider broken", "provider odd"]
    with pytest.raises(FingerflowError, match="its numbers are not"):
        choice.engine_of_stream(bundle, "onnx", "odd")


def test_files_that_are_none_of_a_bundle_are_named(bundle: Bundle, tmp_path: Path) -> None:
    def opened(**files: Path) -> GraphEngine:
        return choice.open_onnx(dataclasses.replace(bundle, files={**bundle.files, **files}))

    with pytest.raises(FingerflowError, match=r"contact\.onnx: holds 'contact' where the graph 'track' is expected"):
        opened(track=bundle.files["contact"])
    (tmp_path / "a.onnx").write_bytes(b"nothing")
    with pytest.raises(FingerflowError, match=r"a\.onnx: onnxruntime cannot load it"):
        opened(fit=tmp_path / "a.onnx")
    model = onnx.load(bundle.files["fit"])
    del model.metadata_props[:]
    onnx.save(model, tmp_path / "fit.onnx")
    with pytest.raises(FingerflowError, match="no fingerflow metadata"):
        opened(fit=tmp_path / "fit.onnx")
    for value in ("float16[3]", "float[n]"):
        text = f'<ir_version: 8, opset_import: ["": 18]> track ({value} a) => ({value} b) {{ b = Identity(a) }}'
        model = onnx.parser.parse_model(text)
        onnx.helper.set_model_props(model, {"fingerflow.graph": "track"})
        onnx.save(model, tmp_path / "track.onnx")
        with pytest.raises(FingerflowError, match=r"track\.onnx: a is tensor\(float.*; the engine needs a usual"):
            opened(track=tmp_path / "track.onnx")


def test_the_onnx_engine_runs_without_torch(bundle: Bundle) -> None:
    """The ONNX engine runs where torch, scipy, cv2 and onnx cannot be imported."""
    code = """
import sys
sys.modules.update({name: None for name in ("torch", "scipy", "cv2", "onnx")})
from pathlib import Path
from fingerflow.engines.check import check_engine
from fingerflow.engines.choice import open_onnx
from fingerflow.engines.bundle import load_bundle
bundle = load_bundle(Path(sys.argv[1]))
check_engine(open_onnx(bundle), bundle.expected)
"""
    command = [sys.executable, "-c", code, str(bundle.folder)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, env=None)
    assert ended.returncode == 0, ended.stderr


def test_onnx_runtime_sends_no_usage_data(tmp_path: Path) -> None:
    """It would write a database of events below the home directory as it is imported."""
    surroundings = {name: value for name, value in os.environ.items() if name != "ORT_DISABLE_TELEMETRY"}
    surroundings |= {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}
    subprocess.run([sys.executable, "-c", "import fingerflow.engines.sessions"], env=surroundings, check=True)
    assert not [*tmp_path.rglob("*")]
