"""Tests of calls of several recordings joined by the engine of torch, against each call by itself."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch

from fingerflow.engines.engine import EngineSettings, FoundPoints
from fingerflow.engines.torch import TorchEngine
from fingerflow.graphs import ContactGraph
from fingerflow.kernels import tensors as kernels
from tests.small_trials import HEIGHT, TRIALS, WIDTH

Array = np.ndarray[Any, Any]
Many = list[tuple[Any, ...]]

PRESS = TRIALS["press"]
FIRST = (58, 50, 40)  # first frame of each recording
COUNTS, FRAMES = (30, 45, 18), (4, 2, 3)
# px and grey levels: matrix products are summed in another order when calls are joined.
CLOSE = {"rtol": 1e-4, "atol": 1e-4, "equal_nan": True}


@pytest.fixture(autouse=True)
def portable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Turn off the compiled kernels, which do not serve on an accelerator."""
    monkeypatch.setattr(kernels, "serve", lambda *tensors: False)


@pytest.fixture
def engine() -> Iterator[TorchEngine]:
    with torch.inference_mode():
        yield TorchEngine(EngineSettings(window_px=15, forward_backward_limit_px=0.5), torch.device("cpu"))


def view(name: str, *frames: int) -> Array:
    """Return views (K, H, W) of frames of the press."""
    return np.stack([PRESS.views[name].crop(PRESS.render(frame)) for frame in frames]).astype(np.uint8)


def images(engine: TorchEngine, name: str, recording: int, start: int = 0) -> Any:
    first = FIRST[recording] + start
    return engine.images(view(name, *range(first, first + FRAMES[recording])))


def points(recording: int) -> Array:
    """Return positions (N, 2) px, some of them NaN and one at the border of the picture."""
    random = np.random.default_rng(recording)
    found = random.uniform((15, 15), (WIDTH - 15, HEIGHT - 15), (COUNTS[recording], 2)).astype(np.float32)
    found[::7] = np.nan
    found[1] = (2, 2)
    return found


def warps(recording: int) -> Array:
    random = np.random.default_rng(10 + recording)
    return np.eye(2, dtype=np.float32) + random.normal(0, 0.02, (COUNTS[recording], 2, 2)).astype(np.float32)


def found_of(engine: TorchEngine, recording: int) -> FoundPoints:
    """Return points found near their start, with one 6 px off and one lost."""
    start, random = points(recording), np.random.default_rng(20 + recording)
    count = FRAMES[recording], COUNTS[recording]
    places = (start + random.normal(0, 0.3, (*count, 2))).astype(np.float32)
    places[0, 4] += 6
    places[1, 5] = np.nan
    lost = np.isnan(places[..., 0])
    spread = np.where(lost, np.nan, random.uniform(1e-4, 4e-4, count)).astype(np.float32)
    covariance = spread[..., None, None] * np.eye(2, dtype=np.float32)
    return FoundPoints(places, spread, covariance, lost.astype(np.uint8), places)


def contact_of(engine: TorchEngine) -> Many:
    glass, dark = (PRESS.views["contact"].crop(one) for one in (PRESS.empty(), PRESS.dark()))
    lights = [engine.light(glass, dark), engine.light(0.9 * glass, dark), engine.light(glass, None)]
    limits = [np.full(frames, 0.2 + 0.05 * k, np.float32) for k, frames in enumerate(FRAMES)]
    return [(images(engine, "contact", k), lights[k], limits[k]) for k in range(3)]


def threshold_of(engine: TorchEngine) -> Many:
    return [one[:2] for one in contact_of(engine)]


def noise_of(engine: TorchEngine) -> Many:
    return [(images(engine, "topography", k)[:1],) for k in range(3)]


def keys(engine: TorchEngine) -> list[Any]:
    return [engine.key(one) for (one,) in noise_of(engine)]


def prepare_of(engine: TorchEngine) -> Many:
    return [(key, points(k), None) for k, key in enumerate(keys(engine))]


def prepare_deformed_of(engine: TorchEngine) -> Many:
    return [(key, points(k), warps(k)) for k, key in enumerate(keys(engine))]


def follow_of(engine: TorchEngine) -> Many:
    """Return arguments of `follow` with guesses up to 5 px off, so that some points are searched for in a
    second round.
    """
    every = []
    for k, given in enumerate(prepare_of(engine)):
        off = np.random.default_rng(30 + k).normal(0, 2, (COUNTS[k], 2)).astype(np.float32)
        every.append((engine.prepare(*given), images(engine, "topography", k, 1), points(k) + off, 0 * off, None))
    return every


def follow_some_of(engine: TorchEngine) -> Many:
    chosen = [np.arange(1, 9), np.array([3]), np.array([17, 2, 5])]
    given = zip(follow_of(engine), chosen, strict=True)
    return [(held, some, place[rows], speed[rows], rows) for (held, some, place, speed, _), rows in given]


def correct_of(engine: TorchEngine) -> Many:
    given = enumerate(prepare_deformed_of(engine))
    return [(points(k), found_of(engine, k), engine.prepare(*one).numbers, warps(k)) for k, one in given]


def outliers_of(engine: TorchEngine) -> Many:
    return [(engine.neighbours(points(k)), points(k), found_of(engine, k)) for k in range(3)]


def windows_of(engine: TorchEngine) -> Many:
    numbers = [np.arange(COUNTS[k]) % FRAMES[k] for k in range(3)]
    return [(images(engine, "topography", k), numbers[k], points(k), warps(k), 3) for k in range(3)]


def leaves(result: Any) -> list[Array]:
    if isinstance(result, tuple):
        return [leaf for one in result if one is not None for leaf in leaves(one)]
    if hasattr(result, "templates"):
        return [one.numpy() for one in result.templates]
    return [np.asarray(result)]


@pytest.mark.parametrize(
    "given",
    [
        *(contact_of, threshold_of, noise_of, prepare_of, prepare_deformed_of, follow_of, follow_some_of),
        *(correct_of, outliers_of, windows_of),
    ],
)
def test_joined_calls_equal_separate_calls(engine: TorchEngine, given: Callable[[TorchEngine], Many]) -> None:
    method = given.__name__.split("_")[0]
    found = engine.begun(method, given(engine))()
    for one, arguments in zip(found, given(engine), strict=True):
        for ours, theirs in zip(leaves(one), leaves(getattr(engine, method)(*arguments)), strict=True):
            assert ours.shape == theirs.shape
            assert ours.dtype == theirs.dtype
            # Template statistics are small differences of large sums in single precision.
            size = max(1.0, 0.01 * float(np.nanmax(np.abs(theirs))))
            np.testing.assert_allclose(ours, theirs, CLOSE["rtol"], size * CLOSE["atol"])


def test_views_of_another_size_are_computed_in_a_call_of_their_own(
    engine: TorchEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = contact_of(engine)
    smaller = tuple(one[..., :160] for one in (given[1][0], *given[1][1]))
    given[1] = smaller[0], type(given[1][1])(*smaller[1:]), given[1][2]
    forward, sizes = ContactGraph.forward, list[int]()
    monkeypatch.setattr(ContactGraph, "forward", lambda self, *one: sizes.append(len(one[0])) or forward(self, *one))
    found = engine.begun("contact", given)()
    assert sizes == [FRAMES[0] + FRAMES[2], FRAMES[1]]
    assert [one.real_area_px.shape for one in found] == [(frames,) for frames in FRAMES]


def test_engines_that_differ_are_of_other_kinds(engine: TorchEngine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only engines of equal settings are of one kind, so that their calls are joined; with compiled kernels each engine
    is of its own kind.
    """
    device = torch.device("cpu")
    assert engine.kind() == TorchEngine(engine.settings, device).kind()
    assert engine.kind() != TorchEngine(EngineSettings(window_px=17), device).kind()
    monkeypatch.setattr(kernels, "serve", lambda *tensors: True)
    assert engine.kind() != TorchEngine(engine.settings, device).kind()
