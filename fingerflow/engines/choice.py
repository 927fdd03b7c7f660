"""Choice of the engine for a recording or a stream."""

from __future__ import annotations

import logging
import os
from typing import TYPE_CHECKING

from fingerflow.engines.bundle import GRAPHS, Bundle
from fingerflow.engines.check import check_engine
from fingerflow.engines.engine import Engine, EngineSettings
from fingerflow.errors import FingerflowError
from fingerflow.kernels.library import is_present

if TYPE_CHECKING:
    import torch

    from fingerflow.engines.graph_engine import GraphEngine

#: Engines of a recording: "auto" chooses native where it is available and torch elsewhere; the others are chosen by
#: name.
ENGINES = ("auto", "native", "torch", "onnx")
#: Engines of a stream: the compiled library ("native"), and the graphs of a bundle run by ONNX Runtime ("onnx"). By
#: default the first that works is used.
STREAM_ENGINES = ("native", "onnx")
log = logging.getLogger("fingerflow.player")


def engine_for(name: str, settings: EngineSettings, device: torch.device) -> Engine:
    """Create the engine that computes a recording, by the name of the engine or by automatic choice.

    Args:
        name: one of `ENGINES`; "auto" is native on a CPU with the compiled library and torch elsewhere.
        settings: of the engine.
        device: on which tensors are computed.

    Raises:
        FingerflowError: native is requested where it cannot be used.
    """
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
    if name == "auto" and device.type == "cpu" and os.environ.get("FINGERFLOW_KERNELS") != "0":
        log.warning(
            "the compiled library is not there, so that torch computes, several times slower; install again where a "
            "C++ compiler is"
        )
    return TorchEngine(settings, device)


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
        from fingerflow.engines.sessions import installed_providers
    except ModuleNotFoundError as error:
        raise FingerflowError(
            f"no engine serves here: native does not ({why}), and onnxruntime cannot be loaded ({error}); install it: "
            f"pip install onnxruntime"
        ) from None
    names = [provider] if provider else list(installed_providers())
    for short in names:
        try:
            engine = open_onnx(bundle, short, threads)
            check_engine(engine, bundle.expected)
            break
        except FingerflowError as error:
            if short == names[-1]:
                raise
            log.warning("provider %s does not serve here and the next is taken: %s", short, error)
    log.info("engine: %s, as %s", engine.described, why)
    return engine


def open_onnx(bundle: Bundle, provider: str = "cpu", threads: int = 1) -> GraphEngine:
    """Open the graphs of a bundle with an execution provider; arguments and errors are those of
    `sessions.open_sessions`.
    """
    from fingerflow.engines.graph_engine import GraphEngine
    from fingerflow.engines.sessions import open_sessions, provider_named

    sessions = open_sessions(bundle.files, provider, threads)
    return GraphEngine(sessions, bundle.engine_settings, bundle.points, f"onnx ({provider_named(provider)})")


def _why_not_native(bundle: Bundle) -> str:
    """Return the reason why the compiled library cannot be used for a bundle; an empty string if it can."""
    if not is_present():
        return "the compiled library is not there, is turned off, or is of another version"
    from fingerflow.engines.native import NativeEngine

    try:
        check_engine(NativeEngine(bundle.engine_settings), bundle.expected)
    except (FingerflowError, RuntimeError, MemoryError) as error:
        return f"the compiled library fails on a built-in frame ({error})"
    return ""
