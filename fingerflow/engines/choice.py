"""Which engine computes: chosen here alone."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from fingerflow.engines.check import check_engine
from fingerflow.engines.engine import Engine, EngineSettings
from fingerflow.errors import FingerflowError
from fingerflow.kernels.library import is_present

if TYPE_CHECKING:
    import torch

    from fingerflow.engines.torch import Modules

#: Of a recording: native where it serves and torch elsewhere, the compiled library, torch, ONNX Runtime.
ENGINES = ("auto", "native", "torch", "onnx")
#: Of a stream: the compiled library, the graphs of a bundle by ONNX Runtime; by default the first that serves.
STREAM_ENGINES = ("native", "onnx")
log = logging.getLogger("fingerflow.player")


class PlayableBundle(Protocol):
    """What is asked of a deployment bundle."""

    @property
    def recipe(self) -> Mapping[str, Any]: ...
    @property
    def files(self) -> Mapping[str, Path]: ...
    @property
    def expected(self) -> Mapping[str, Any]: ...

    @property
    def engine_settings(self) -> EngineSettings:
        """With which its graphs were exported."""
        ...


def engine_for(name: str, settings: EngineSettings, device: torch.device, modules: Modules | None = None) -> Engine:
    """The engine of a recording.

    Args:
        name: "auto" for native on a processor with the compiled library, and torch elsewhere; "native", "torch".
        device: on which tensors are computed.
        modules: gives the module to call in place of one (`engines.torch`), which asks for the engine torch.

    Raises:
        FingerflowError: native is asked for where it does not serve.
    """
    from fingerflow.engines.torch import TorchEngine, as_it_is
    from fingerflow.kernels.tensors import serve

    serves = device.type == "cpu" and serve()
    if name == "native" and not serves:
        raise FingerflowError(
            f"the engine native needs a processor and the compiled library, which does not serve here (device "
            f"{device}); choose auto or torch, or install where a C++ compiler is"
        )
    if modules is None and name != "torch" and serves:
        from fingerflow.engines.native import NativeEngine

        return NativeEngine(settings)
    return TorchEngine(settings, device, modules or as_it_is)


def engine_of_stream(bundle: PlayableBundle, name: str | None, provider: str | None = None, threads: int = 1) -> Engine:
    """The engine of a stream; one line of the log says which, and why.

    Native is tried first: it serves where the library loads and gives the numbers of the bundle's built-in frame. Else
    ONNX Runtime does, with the graphs of the bundle, by the first execution provider that runs them and gives these
    numbers too.

    Args:
        bundle: whose settings and graphs are taken.
        name: of `STREAM_ENGINES`, which insists; None for the first that serves.
        provider: of ONNX Runtime, by its short name, which insists; None for the first that serves.
        threads: inside an operator of ONNX Runtime.

    Raises:
        FingerflowError: the engine that is insisted on does not serve, or none does.
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
    try:
        from fingerflow.engines.onnx import OnnxEngine
        from fingerflow.engines.providers import CPU, installed_providers
    except ModuleNotFoundError as error:
        raise FingerflowError(
            f"no engine serves here: native does not ({why}), and onnxruntime cannot be loaded ({error}); install it: "
            f"pip install onnxruntime"
        ) from None
    for one in [provider] if provider else installed_providers():
        try:
            engine = OnnxEngine(bundle.files, bundle.engine_settings, one, threads)
            check_engine(engine, bundle.expected)
            break
        except FingerflowError as error:
            if provider or one == CPU:
                raise
            log.warning("provider %s does not serve here and the next is taken: %s", one, error)
    log.info("engine: %s, as %s", engine.described, why)
    return engine


def _why_not_native(bundle: PlayableBundle) -> str:
    """Why the compiled library does not serve a bundle; empty where it does."""
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
