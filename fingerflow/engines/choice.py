"""Choice of the engine for a recording or a stream."""

from __future__ import annotations

import logging
from functools import cache
from typing import TYPE_CHECKING

from fingerflow.engines.bundle import GRAPHS, Bundle
from fingerflow.engines.check import both_numbers_of, built_in, check_engine, check_frames
from fingerflow.engines.engine import Engine, EngineSettings
from fingerflow.errors import FingerflowError
from fingerflow.kernels.library import is_present

if TYPE_CHECKING:
    import torch

#: Engines of a recording: "auto" chooses native where it is available and torch elsewhere; the others are chosen by
#: name.
ENGINES = ("auto", "native", "torch", "onnx")
#: Engines of a stream: the compiled library ("native"), and the graphs of a bundle run by ONNX Runtime ("onnx"). By
#: default the first that works is used.
STREAM_ENGINES = ("native", "onnx")
_CHECKED_POINTS = 64  # in the built-in frame of a recording: some have enough neighbours
log = logging.getLogger("fingerflow.player")


def engine_for(name: str, settings: EngineSettings, device: torch.device) -> Engine:
    """Create the engine that computes a recording, by the name of the engine or by automatic choice.

    Args:
        name: "native", "torch", or "auto" for native on a CPU with the compiled library and torch elsewhere.
        settings: of the engine.
        device: on which tensors are computed; on a GPU of CUDA calls are replayed as graphs (`engines.capture`).

    Raises:
        FingerflowError: native is requested where it cannot be used, or the GPU computes other numbers of a built-in
            frame than it should, with and without replay.
    """
    from fingerflow.engines.capture import Captured
    from fingerflow.engines.torch import TorchEngine
    from fingerflow.kernels.tensors import serve

    serves = device.type == "cpu" and serve()
    if name == "native" and not serves:
        raise FingerflowError(
            f"the engine native needs a processor and the compiled library, which does not serve here (device "
            f"{device}); choose auto or torch, or install where a C++ compiler is"
        )
    if name != "torch" and serves:
        from fingerflow.engines.native import NativeEngine

        return NativeEngine(settings)
    if device.type == "cuda" and _captures(settings, device):
        return TorchEngine(settings, device, Captured)
    return TorchEngine(settings, device)


@cache
def _captures(settings: EngineSettings, device: torch.device) -> bool:
    """Return whether replay of modules as CUDA graphs works with these settings: two different built-in frames must
    each give the results that the processor gives; log a warning if not.

    Raises FingerflowError if they do not without replay either.
    """
    import torch

    from fingerflow.engines.capture import Captured
    from fingerflow.engines.points_graph import check_track
    from fingerflow.engines.torch import TorchEngine

    side = max(96, 4 * settings.window_px)
    frame = built_in(side, side, 8, _CHECKED_POINTS, settings.window_px)
    expected = both_numbers_of(TorchEngine(settings, torch.device("cpu")), frame, deviations=True)
    try:
        replayed = TorchEngine(settings, device, Captured)
        check_frames(replayed, frame, expected)
        check_track(replayed, frame)
    except FingerflowError as error:
        log.warning("the modules are not captured as graphs and computed call by call: %s", error)
        check_frames(TorchEngine(settings, device), frame, expected)
        return False
    return True


def engine_of_stream(bundle: Bundle, name: str | None, provider: str | None = None, threads: int = 1) -> Engine:
    """Create the engine that computes a stream of frames, and log the choice with the reason.

    Native is tried first: it is taken if the library loads and reproduces the expected results of the bundle for the
    built-in frame. Otherwise ONNX Runtime computes the graphs of the bundle, with the first execution provider that
    runs them and reproduces these results.

    Args:
        bundle: deployment bundle with the settings and the graphs.
        name: one of `STREAM_ENGINES`, with no fallback to the other; None for the first that works.
        provider: short name of an execution provider, with no fallback to others if ONNX Runtime is taken; None for the
            first that works.
        threads: inside an operator of ONNX Runtime.

    Raises:
        FingerflowError: the requested engine or provider does not work, or none does.
    """
    why = "it was asked for"
    if name != "onnx":
        why = _why_not_native(bundle)
        if not why:
            from fingerflow.engines.native import NativeEngine

            log.info("engine: native (compiled library)%s", "" if name else ", as it gives the numbers of the graphs")
            return NativeEngine(bundle.engine_settings)
        if name == "native":
            raise FingerflowError(f"--engine native: {why}; leave the option out, or take --engine onnx")
    if absent := [one for one in GRAPHS if one not in bundle.files]:
        raise FingerflowError(
            f"{bundle.folder}: without the graphs {', '.join(absent)} only the compiled library plays the bundle "
            f"({why}); export the recipe without `graphs` in [export]"
        )
    try:
        from fingerflow.engines.onnx import OnnxEngine
        from fingerflow.engines.providers import installed_providers
        from fingerflow.engines.sessions import CAPTURING
    except ModuleNotFoundError as error:
        raise FingerflowError(
            f"no engine serves here: native does not ({why}), and onnxruntime cannot be loaded ({error}); install it: "
            f"pip install onnxruntime"
        ) from None
    names = [provider] if provider else list(installed_providers())
    ways = [(one, captured) for one in names for captured in (True, False) if one in CAPTURING or not captured]
    for one, captured in ways:
        try:
            engine = OnnxEngine(bundle.files, bundle.engine_settings, one, threads, captured)
            check_engine(engine, bundle.expected)
            break
        except FingerflowError as error:
            if (one, captured) == ways[-1]:
                raise
            of_graphs = " with captured graphs" if captured else ""
            log.warning("provider %s does not serve here%s and the next is taken: %s", one, of_graphs, error)
    log.info("engine: %s, as %s", engine.described, why)
    return engine


def _why_not_native(bundle: Bundle) -> str:
    """Return the reason why the compiled library cannot be used for a bundle; an empty string if it can."""
    if not is_present():
        return "the compiled library is not there, is turned off, or is of another version"
    if bundle.recipe["export"]["precision"] != "float32":
        return f"the bundle computes in {bundle.recipe['export']['precision']}, the compiled library in float32"
    from fingerflow.engines.native import NativeEngine

    try:
        check_engine(NativeEngine(bundle.engine_settings), bundle.expected)
    except (FingerflowError, RuntimeError, MemoryError) as error:
        return f"the compiled library fails on a built-in frame ({error})"
    return ""
