"""Execution of torch modules by ONNX Runtime, through the unchanged interface of these modules."""

import contextlib
import functools
import hashlib
import inspect
import json
import logging
import os
import stat
import tempfile
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import torch
from torch import Tensor, nn
from torch.utils import _pytree as tree

from fingerflow.export.calls import GraphCall, axes_that_differ, pad_points, settings_of
from fingerflow.export.portable import Portable
from fingerflow.export.standard_model import need_packages, standard_model

M = TypeVar("M", bound=nn.Module)
# Packages with the code of the graphs; a change in them invalidates cached graphs.
_SOURCES = ("export", "graphs", "ops")
_PATIENCE = 60.0  # s of export after which a warning explains the delay
# Smallest number of points to which inputs are padded, so that the small groups of points where skin enters share one
# graph.
_LEAST_POINTS = 256
log = logging.getLogger(__name__)


class OnnxRuntime:
    """Factory of wrappers around torch modules, whose methods are executed by ONNX Runtime on the CPU.

    A method is exported when it is first called with tensors of new shapes. Batches are processed one recording at a
    time. Graphs are cached in a folder by settings, shapes and source code. The number of points does not need a new
    graph: arguments whose axis of points a module states (``point_axes``, by name) are padded with NaN points to a
    power of two, at least 256, as in a bundle that finds fewer points than its maximum.

    Args:
        threads: inside an operator.
        folder: cache of the graphs; by default a folder of this user among the temporary files.

    Attributes:
        exported, seconds: number of exported graphs, and the total time of export.

    Raises:
        FingerflowError: packages are missing, or a method needs operators that are not standard.
    """

    def __init__(self, threads: int, folder: Path | None = None) -> None:
        need_packages()
        self.folder = folder or _cache_folder()
        self.threads = threads
        self.exported, self.seconds = 0, 0.0

    def __call__(self, module: M) -> M:
        """Return a wrapper of a torch module that is used like the module, but whose methods ONNX Runtime executes."""
        return cast(M, _WrappedModule(module, self))

    def session(self, leaves: "_ExportedMethod", tensors: list[Tensor], inputs: Sequence[str], outputs: int) -> Any:
        """Open an ONNX Runtime session for a wrapped method and tensors of these shapes, with input names and number of
        outputs; export the graph first if it is not cached.
        """
        import onnxruntime

        file = self.folder / f"{self._name(leaves, tensors, inputs)}.onnx"
        if not file.exists():
            begun = time.perf_counter()
            names = [f"result_{place}" for place in range(outputs)]
            # Clone the inputs: the exporter would merge two inputs that are the same tensor.
            with torch.inference_mode(False):
                model = standard_model(leaves, tuple(one.clone() for one in tensors), inputs, names)
            self.folder.mkdir(parents=True, exist_ok=True)
            part = file.with_suffix(f".{os.getpid()}")
            part.write_bytes(model.SerializeToString(deterministic=True))
            part.replace(file)
            seconds = time.perf_counter() - begun
            before, self.seconds = self.seconds, self.seconds + seconds
            self.exported += 1
            if before < _PATIENCE <= self.seconds:
                warnings.warn(
                    f"{self.exported} graphs have been exported to ONNX, which took {self.seconds:.0f} s, and there "
                    f"may be more to come. They are kept in {self.folder} for recordings of the same size and "
                    "settings; engine torch needs none",
                    stacklevel=2,
                )
            log.info("%s exported to ONNX in %.1f s: %s", leaves.title, seconds, file)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = self.threads
        return onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])

    def _name(self, leaves: "_ExportedMethod", tensors: list[Tensor], inputs: Sequence[str]) -> str:
        """Return the cache name of a graph: a hash of method, settings, shapes, arguments, torch version and source."""
        shapes = [(name, str(one.dtype), list(one.shape)) for name, one in zip(inputs, tensors, strict=True)]
        facts = [
            _source_hash(),
            torch.__version__,
            leaves.title,
            settings_of(leaves.module),
            shapes,
            repr(leaves.call.settings),
        ]
        digest = hashlib.sha256(json.dumps(facts).encode()).hexdigest()
        return f"{leaves.title}-{digest[:24]}"


class _WrappedModule:
    """Wrapper of a torch module with the same attributes, whose methods ONNX Runtime executes."""

    def __init__(self, module: nn.Module, runtime: OnnxRuntime) -> None:
        self._module, self._runtime = module, runtime
        self._sessions: dict[Any, tuple[Any, list[Any], Any]] = {}

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return self._answer("forward", *arguments, **named)

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._module, name)
        return functools.partial(self._answer, name) if inspect.ismethod(value) else value

    def _answer(self, method: str, *arguments: Any, **named: Any) -> Any:
        call = GraphCall.of(self._module, method, arguments, named)
        batch = max(map(len, call.tensors))
        results = [self._run_one(method, call.of_recording(one, batch)) for one in range(batch)]
        return tree.tree_map(lambda *some: torch.cat(some) if isinstance(some[0], Tensor) else some[0], *results)

    def _run_one(self, method: str, call: GraphCall) -> Any:
        given, along, points = call.tensors, call.tensor_axes, call.points
        inputs = [name for name, value in zip(call.names, call.values, strict=True) if isinstance(value, Tensor)]
        tensors = pad_points(given, along, _padded_count(points))
        key = (
            method,
            repr(call.settings),
            tuple(call.names),
            tuple((name, one.dtype, one.shape) for name, one in zip(inputs, tensors, strict=True)),
        )
        if key not in self._sessions:
            leaves = _ExportedMethod(self._module, method, call)
            with Portable():  # traced in portable form, since compiled kernels may return fewer results
                result, result_structure = tree.tree_flatten(leaves.result(*tensors))
                more = result
                if points:
                    more = tree.tree_leaves(leaves.result(*pad_points(given, along, _padded_count(points) + 1)))
            # For each result, its axes that depend on the number of points; None for a result that is no tensor.
            of_results = [
                axes_that_differ(leaf, other) if isinstance(leaf, Tensor) else None
                for leaf, other in zip(result, more, strict=True)
            ]
            count = sum(axes is not None for axes in of_results)
            session = self._runtime.session(leaves, tensors, [f"input_{place}" for place in range(len(tensors))], count)
            self._sessions[key] = session, of_results, result_structure
        session, of_results, result_structure = self._sessions[key]
        feed = {f"input_{place}": one.detach().contiguous().numpy() for place, one in enumerate(tensors)}
        known = {one.name for one in session.get_inputs()}  # the session lacks inputs that the graph does not use
        found = iter(session.run(None, {name: array for name, array in feed.items() if name in known}))
        joined: list[Tensor | None] = []
        for axes in of_results:
            if axes is None:
                joined.append(None)
                continue
            tensor = torch.from_numpy(next(found))
            for axis in axes:
                tensor = tensor.narrow(axis, 0, points)
            joined.append(tensor)
        return tree.tree_unflatten(joined, result_structure)


def _padded_count(points: int) -> int:
    """Return the power of 2 to which a number of points is padded; 0 for 0 points."""
    return max(_LEAST_POINTS, 1 << (points - 1).bit_length()) if points else 0


class _ExportedMethod(nn.Module):
    """Torch module that wraps a method for ONNX export: it takes tensors by position and returns a tuple of tensors."""

    def __init__(self, module: nn.Module, method: str, call: GraphCall) -> None:
        super().__init__()
        self.module, self.method, self.call = module, method, call
        self.title = type(module).__name__ if method == "forward" else f"{type(module).__name__}.{method}"

    def result(self, *tensors: Tensor) -> Any:
        """Call the wrapped method and return its original result, not flattened to a tuple."""
        return getattr(self.module, self.method)(**self.call.with_tensors(tensors))

    def forward(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        results = [leaf for leaf in tree.tree_leaves(self.result(*tensors)) if isinstance(leaf, Tensor)]
        # An argument that is returned unchanged would give an output with the name of an input, so it is cloned.
        return tuple(leaf.clone() if any(leaf is one for one in tensors) else leaf for leaf in results)


def _cache_folder() -> Path:
    """Return the user's cache folder for graphs, or a new temporary folder if others may have put files there."""
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "")
    folder = Path(tempfile.gettempdir()) / f"fingerflow-graphs-{user}"
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    return folder if _is_private(folder) else Path(tempfile.mkdtemp(prefix=folder.name))


def _is_private(folder: Path) -> bool:
    """Return whether a path is a folder of this user, not a link, to which no other user may write."""
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode):
        return False
    # On Windows, which has no `getuid`, each user has a temporary folder of their own.
    return not hasattr(os, "getuid") or (found.st_uid == os.getuid() and not found.st_mode & 0o022)


@functools.cache
def _source_hash() -> str:
    """Return a hash of the source code that determines the exported graphs."""
    digest = hashlib.sha256()
    package = Path(__file__).parents[1]
    for file in sorted(file for room in _SOURCES for file in (package / room).rglob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()
