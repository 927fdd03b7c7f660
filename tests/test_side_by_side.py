"""Recordings computed side by side against each by itself."""

import weakref
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial, wraps
from inspect import signature
from pathlib import Path
from threading import Event, Thread, Timer
from typing import Any

import numpy as np
import pytest
import torch
import xarray as xr
from torch import Tensor

from fingerflow import kernels, process
from fingerflow.errors import FingerflowError
from fingerflow.graphs.contact import ContactGraph
from fingerflow.graphs.key import KeyGraph
from fingerflow.graphs.track import DeformationGraph, TrackGraph
from fingerflow.ops.templates import Templates
from fingerflow.pipeline import process_to
from fingerflow.side_by_side import side_by_side
from fingerflow.stages.inputs import Engine
from fingerflow.synthetic import Press, write_recording

_FRAME = {"frame_rate": 10.0, "frames_before_trigger": 1, "frame_shape": (96, 240), "finger": (1.8, 1.5)}
_TRIALS = (
    Press(n_frames=10, semi_axes=(1.3, 1.1), **_FRAME),
    Press(n_frames=10, semi_axes=(1.2, 1.1), shift=(-0.2, 0.1), **_FRAME),
    Press(n_frames=6, semi_axes=(1.1, 1.0), gradient=((-0.02, 0.01), (0.0, -0.03)), **_FRAME),  # ends sooner
)
_POINTS = (40, 60, 33)
# px: portable products of matrices are summed in another order when there are more of them, and the fit of a gradient
# divides that by a window.
_ROUNDING = {"position_px": 1e-4, "divergence": 2e-5, "curl": 2e-5, "real_contact_area": 0.0, "median_divergence": 2e-5}


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three trials in frames of one size, with other skin motion, numbers of points and of frames."""
    found = []
    for trial, points in zip(_TRIALS, _POINTS, strict=True):
        folder = tmp_path_factory.mktemp("trial") / "recording"
        write_recording(folder, trial)
        scene = folder / "scene.toml"
        text = scene.read_text(encoding="utf-8")
        assert text.count("points = 700") == 1
        scene.write_text(text.replace("points = 700", f"points = {points}"), encoding="utf-8")
        found.append(scene)
    return found


@pytest.fixture
def portable(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on an accelerator, for which there are no compiled kernels; in all threads."""
    monkeypatch.setattr(kernels, "serve", lambda *tensors: False)


def together(scenes: list[Path]) -> list[xr.Dataset]:
    """Results of scenes computed side by side."""
    return side_by_side([lambda engine, scene=scene: process(scene, device="cpu", engine=engine) for scene in scenes])


def alone(scenes: list[Path]) -> list[xr.Dataset]:
    return [process(scene, device="cpu") for scene in scenes]


def compare(found: xr.Dataset, expected: xr.Dataset, rounding: dict[str, float] | None = None) -> None:
    """All variables bit for bit, or those that are named to so much."""
    assert set(found) == set(expected)
    for name in found if rounding is None else rounding:
        if rounding is None:
            np.testing.assert_array_equal(found[name].values, expected[name].values, err_msg=str(name))
        else:
            np.testing.assert_allclose(
                found[name].values, expected[name].values, rtol=0, atol=rounding[str(name)], err_msg=str(name)
            )


@pytest.fixture
def batches(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[int]]:
    """How many frames, or recordings, each call of a graph is of, from now on."""
    seen: dict[str, list[int]] = {}
    for graph, image in ((ContactGraph, "frames"), (TrackGraph, "view")):
        sizes = seen[graph.__name__] = []
        forward = graph.forward

        @wraps(forward)
        def counted(
            *given: Any, _sizes: list[int] = sizes, _of: Any = forward, _image: str = image, **named: Any
        ) -> Any:
            _sizes.append(len(signature(_of).bind(*given, **named).arguments[_image]))
            return _of(*given, **named)

        monkeypatch.setattr(graph, "forward", counted)
    return seen


@pytest.mark.usefixtures("portable")
def test_one_call_of_a_graph_is_of_all_recordings(scenes: list[Path], batches: dict[str, list[int]]) -> None:
    expected, most = [], dict.fromkeys(batches, 0)
    for scene in scenes:
        expected += alone([scene])
        most = {name: max(most[name], len(sizes)) for name, sizes in batches.items()}
        assert max(batches["TrackGraph"]) == 1
        for sizes in batches.values():
            sizes.clear()
    found = together(scenes)
    for one, other in zip(found, expected, strict=True):
        assert one.sizes == other.sizes
        np.testing.assert_array_equal(one["status"].values, other["status"].values)
        compare(one, other, _ROUNDING)
    assert {name: max(sizes) for name, sizes in batches.items()} == {"ContactGraph": 22, "TrackGraph": 3}
    # Together they take as many calls as the one that needs most, and two that only look at shapes.
    for name, sizes in batches.items():
        assert len(sizes) <= most[name] + 2


@pytest.mark.usefixtures("portable")
def test_the_same_again_is_the_same_bit_for_bit(scenes: list[Path]) -> None:
    for one, other in zip(together(scenes), together(scenes), strict=True):
        compare(one, other)


def test_compiled_kernels_give_each_its_own_numbers(scenes: list[Path]) -> None:
    """But for the last digit: where fewer points are filled up, others are in the rest that is computed one by one."""
    for one, other in zip(together(scenes), alone(scenes), strict=True):
        compare(one, other, {str(name): 1e-6 for name in one if one[name].dtype.kind == "f"})


@pytest.mark.usefixtures("portable")
def test_other_settings_are_asked_by_themselves(scenes: list[Path], batches: dict[str, list[int]]) -> None:
    text = scenes[1].read_text(encoding="utf-8")
    other = scenes[1].with_name("other.toml")
    other.write_text(text.replace("forward_backward_limit_px = 1.0", "forward_backward_limit_px = 0.5"), "utf-8")
    given = [scenes[0], other]
    for one, expected in zip(together(given), alone(given), strict=True):
        compare(one, expected, _ROUNDING)
    assert max(batches["TrackGraph"]) == 1


@pytest.mark.usefixtures("portable")
def test_what_fails_for_all_is_computed_one_by_one(scenes: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """As where the memory of an accelerator holds one recording and not two."""
    expected = alone(scenes[:2])
    forward, refused = TrackGraph.forward, []

    def small(self: TrackGraph, templates: Any, view: Tensor, prediction: Tensor) -> Any:
        if len(view) > 1:
            refused.append(len(view))
            raise torch.OutOfMemoryError("no room for two")
        return forward(self, templates, view, prediction)

    monkeypatch.setattr(TrackGraph, "forward", small)
    for one, other in zip(together(scenes[:2]), expected, strict=True):
        compare(one, other, _ROUNDING)
    assert refused


@pytest.mark.usefixtures("portable")
def test_an_error_of_one_is_its_own(scenes: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever it comes from: a scene, or a call that was joined with those of others."""
    forward = TrackGraph.forward

    def breaks(self: TrackGraph, templates: Any, view: Tensor, prediction: Tensor) -> Any:
        if templates.start.shape[1] == _POINTS[2] or len(view) > 1:
            raise FingerflowError("the third one")
        return forward(self, templates, view, prediction)

    monkeypatch.setattr(TrackGraph, "forward", breaks)
    missing = scenes[0].with_name("missing.toml")
    given = [scenes[0], missing, scenes[1], scenes[2]]
    ended: list[str] = []

    def act(place: int, engine: Engine) -> None:
        try:
            process_to(tmp_path / f"{place}.h5", given[place], device="cpu", engine=engine)
            ended.append(f"{place}")
        except FingerflowError as error:
            ended.append(f"{place}: {error}")
            raise

    acts: list[Callable[[Engine], None]] = [partial(act, place) for place in range(4)]
    with pytest.raises(FingerflowError, match=r"missing\.toml"):
        side_by_side(acts)
    assert len(ended) == 4
    assert {"0", "2", "3: the third one"} < set(ended)
    assert {path.name for path in tmp_path.iterdir()} == {"0.h5", "2.h5"}


def _asks(engine: Engine) -> Tensor:
    """A recording that asks the graph of keys once."""
    key: Templates = engine(KeyGraph())(torch.zeros(1, 1, 64, 64), torch.full((1, 2, 2), 32.0))
    return key.start


def test_of_nobody_there_is_nothing() -> None:
    assert side_by_side([]) == []


@pytest.mark.usefixtures("portable")
def test_no_error_of_a_graph_leaves_others_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    def exits(self: KeyGraph, view: Tensor, points: Tensor) -> None:
        raise SystemExit(3)

    monkeypatch.setattr(KeyGraph, "forward", exits)
    with pytest.raises(SystemExit, match="3"):
        _in_time(lambda: side_by_side([_asks, _asks]))


@pytest.mark.parametrize("stop", [KeyboardInterrupt, RuntimeError])
def test_an_end_from_outside_ends_who_waits(monkeypatch: pytest.MonkeyPatch, stop: type[BaseException]) -> None:
    """Ctrl-C while all run, and a system that has no thread for the second one."""
    begun, go_on, ended = Event(), Event(), []

    def asks(engine: Engine) -> None:
        begun.set()
        try:
            assert go_on.wait(20)
            _asks(engine)
        except BaseException as error:
            ended.append(type(error).__name__)
            raise

    def stopped(*given: Any, **named: Any) -> None:
        assert begun.wait(20)
        Timer(0.05, go_on.set).start()
        raise stop

    if stop is KeyboardInterrupt:
        monkeypatch.setattr("fingerflow.side_by_side.wait", stopped)
    else:
        submit, taken = ThreadPoolExecutor.submit, []

        def only_one(pool: ThreadPoolExecutor, *given: Any) -> Any:
            taken.append(given)
            return stopped() if len(taken) > 1 else submit(pool, *given)

        monkeypatch.setattr("fingerflow.side_by_side.ThreadPoolExecutor.submit", only_one)
    with pytest.raises(stop):
        _in_time(lambda: side_by_side([asks, asks]))
    assert set(ended) == {"_Stopped"}


@pytest.mark.usefixtures("portable")
def test_each_is_computed_when_the_memory_of_all_is_free_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """As what a call of all has taken is no use while each is computed by itself."""
    forward, held = KeyGraph.forward, []

    def small(self: KeyGraph, view: Tensor, points: Tensor, noise: None = None, warp: None = None) -> Any:
        if len(view) > 1:
            taken = view.clone()
            held.append(weakref.ref(taken))
            raise torch.OutOfMemoryError(f"no room for two, {taken.shape}")
        held.append(held[0]())
        return forward(self, view, points)

    monkeypatch.setattr(KeyGraph, "forward", small)
    side_by_side([_asks, _asks])
    assert len(held) == 3
    assert held[1:] == [None, None]


@pytest.mark.usefixtures("portable")
def test_every_axis_of_points_is_cut_to_their_number() -> None:
    """The support of a deformation has two."""
    some = torch.rand(1, 6, 2, generator=torch.Generator().manual_seed(1)) * 50

    def support(count: int, engine: Engine) -> Any:
        return engine(DeformationGraph()).support(some[:, :count])

    found = side_by_side([partial(support, 4), partial(support, 6)])
    assert [one.weights.shape for one in found] == [(1, 4, 4), (1, 6, 6)]
    expected = DeformationGraph().support(some[:, :4])
    assert expected is not None
    torch.testing.assert_close(found[0].weights, expected.weights)


def _in_time(act: Callable[[], object]) -> None:
    """What an act raises; it fails where the act has no end."""
    raised: list[BaseException] = []

    def run() -> None:
        try:
            act()
        except BaseException as error:
            raised.append(error)

    thread = Thread(target=run, daemon=True)
    thread.start()
    thread.join(30)
    assert not thread.is_alive()
    if raised:
        raise raised[0]
