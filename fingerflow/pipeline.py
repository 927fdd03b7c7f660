"""The main job: a scene in, a labelled data set out."""

import json
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import torch
import xarray as xr
from tqdm import tqdm

from fingerflow import __version__
from fingerflow.atomic_write import keep_others, spare, write_atomically
from fingerflow.deviations import stated, withhold
from fingerflow.errors import FingerflowError
from fingerflow.plan import VARIABLES, Plan, plan
from fingerflow.player.contract.variables import Variable
from fingerflow.recordings.identity import identity_of
from fingerflow.result import is_result, open_own, open_result
from fingerflow.reuse import STAGES, TAKEN_OVER, Reused, keys_of, record, reused
from fingerflow.room import check_disk, check_memory, size_of_results
from fingerflow.scene import Scene, load_scene
from fingerflow.stages.inputs import Engine, Inputs, open_inputs, read_frames
from fingerflow.stages.stage import Batch, Stage, Trial
from fingerflow.store import FileStore, MemoryStore, Store

if TYPE_CHECKING:
    from fingerflow.export.runtime import OnnxRuntime

_PICTURES = 8  # frames in memory at a time, and as many on their way
_NUMBERS = 64  # frames at a time where no stage reads pictures
_Given = TypeVar("_Given")
_Result = TypeVar("_Result")


def process(
    scene: Scene | str | Path,
    outputs: Iterable[str] | None = None,
    device: str = "auto",
    progress: bool = False,
    engine: str | Engine = "torch",
    to: str | Path | None = None,
    overwrite: bool = False,
    earlier: str | Path | None = None,
) -> xr.Dataset:
    """Computes ``outputs`` of a scene, and only what they need.

    Args:
        scene: from :func:`~fingerflow.scene.load_scene`, or the path of its file.
        outputs: names of variables, or one name, see ``fingerflow.plan.OUTPUTS``; None for all that the scene allows.
        device: "auto" (CUDA where it is there), "cpu", "cuda" ...
        progress: show a bar.
        engine: what runs the modules of `fingerflow.graphs`: "torch" with its compiled kernels, or "onnx", ONNX Runtime
            on the processor, from graphs as an exported bundle has them. The results agree to rounding. Or what
            `fingerflow.side_by_side` gives each of several recordings, which then share the calls of their graphs.
        to: a file of HDF5/NetCDF4 to which results go as they come, so that memory does not grow with the frames; it
            appears when it is complete. None keeps them in memory.
        overwrite: let that file replace one that is no result of `process`; never an input.
        earlier: a result of the same recording: what does not depend on the settings that have changed since is taken
            from there, and only the rest is computed. The attribute "taken_over" says what; the data are the same, bit
            for bit. It may be the file that is written.

    Returns:
        The data set, with what the stages that ran have given (`fingerflow.player.contract.variables`); of a file, what
        is looked at is read from it.

    Raises:
        FingerflowError: whatever the user can put right, named with its file and value.
    """
    if to is not None:
        process_to(Path(to), scene, outputs, device, progress, engine, overwrite, earlier)
        return open_own(Path(to))
    with _prepared(scene, outputs, device, engine) as ready:
        check_memory(ready.size)
        store = MemoryStore(ready.variables, len(ready.inputs.times))
        _run(ready, store, progress, earlier)
        return store.dataset


def process_to(
    to: Path,
    scene: Scene | str | Path,
    outputs: Iterable[str] | None = None,
    device: str = "auto",
    progress: bool = False,
    engine: str | Engine = "torch",
    overwrite: bool = False,
    earlier: str | Path | None = None,
) -> None:
    """As `process`, into a file that is not opened again."""
    scene = scene if isinstance(scene, Scene) else load_scene(Path(scene))
    spare(to, *scene.files())
    keep_others(to, is_result, overwrite)
    with _prepared(scene, outputs, device, engine) as ready:
        check_disk(to, ready.size)

        def write(part: Path) -> None:
            with FileStore(ready.variables, len(ready.inputs.times), part) as file:
                _run(ready, file, progress, earlier)

        write_atomically(to, write)


@dataclass(frozen=True)
class _Ready:
    """An opened scene, what is to be computed of it, by what, how many bytes that gives, and what can be stated."""

    plan: Plan
    inputs: Inputs
    runtime: "OnnxRuntime | None"
    size: float
    variables: dict[str, Variable]


@contextmanager
def _prepared(
    scene: Scene | str | Path, outputs: Iterable[str] | None, device: str, engine: str | Engine
) -> Iterator[_Ready]:
    scene = scene if isinstance(scene, Scene) else load_scene(Path(scene))
    wanted = plan(None if outputs is None else [outputs] if isinstance(outputs, str) else list(outputs), scene)
    runtime = _onnx_runtime(engine, device) if isinstance(engine, str) else None
    inputs = open_inputs(scene, device if runtime is None else "cpu")
    if runtime is not None:
        inputs.engine = runtime
    elif not isinstance(engine, str):
        inputs.engine, inputs.alone = engine, False
    with inputs.recording:
        given = (one for stage in wanted.stages for one in stage.gives if one.unasked or one.name in wanted.asked)
        size = size_of_results(given, len(inputs.times), scene.tracking.points)
        yield _Ready(wanted, inputs, runtime, size, stated(VARIABLES, inputs.recording.takes_from_other_frames))


def _run(ready: _Ready, store: Store, progress: bool, earlier: str | Path | None) -> None:
    """Every pass of the plan, into the store, but for what an earlier result has."""
    wanted, inputs, runtime = ready.plan, ready.inputs, ready.runtime
    seconds: dict[str, float] = {}
    stages: dict[type[Stage], Stage] = {}
    trial = Trial(inputs, store, wanted.stages, wanted.asked, stages)
    said: dict[str, str] = {}
    with torch.inference_mode(), ExitStack() as held:
        # Of forces alone no picture is looked at.
        recording = identity_of(inputs.recording) if any(one.reads_frames for one in wanted.stages) else ""
        keys = keys_of(wanted, inputs, "torch" if runtime is None else "onnx", recording)
        known: Reused | None = None
        if earlier is not None:
            known = reused(held.enter_context(open_result(Path(earlier))), Path(earlier), wanted, keys, inputs)
            said[TAKEN_OVER] = known.said()
        for kinds in wanted.passes():
            stages.update({kind.place(): kind(trial) for kind in kinds})
            running = [stages[kind.place()] for kind in kinds]
            if known is not None:
                for stage in running:
                    if type(stage).place() in known.stages:
                        with _timed(seconds, stage.name):
                            known.restore(stage)
                running = [stage for stage in running if type(stage).place() not in known.stages]
            _pass(running, trial, seconds, progress)
    if inputs.recording.takes_from_other_frames is not None:
        withhold(store, VARIABLES)
    if runtime is not None:
        seconds["export"] = runtime.seconds  # part of the stages that asked for it
    scene = inputs.scene
    store.finish(
        inputs.times,
        np.arange(len(inputs.times)) + scene.recording.first_frame,
        {
            "title": "fingertip on glass",
            "fingerflow_version": __version__,
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "settings": scene.as_json(),
            "strain_measure": scene.fields.strain,
            "warnings": json.dumps([*inputs.warnings, *(one for stage in stages.values() for one in stage.warnings)]),
            STAGES: record(wanted, keys, stages, store),
            "stage_seconds": json.dumps({name: round(value, 4) for name, value in seconds.items()}),
            "mm_per_px": inputs.mm_per_px,
            "topography_to_contact": json.dumps(inputs.topography_to_contact.tolist()),
            "frames": str(scene.recording.frames),
            **said,
            **({"recording": recording} if recording else {}),
        },
    )


def _pass(stages: Sequence[Stage], trial: Trial, seconds: dict[str, float], progress: bool) -> None:
    """Takes the frames through these stages, batch by batch."""
    for stage in stages:
        with _timed(seconds, stage.name):
            stage.begin()
    stepping = [stage for stage in stages if type(stage).step is not Stage.step]
    if stepping:
        _go_over_frames(stepping, trial, seconds, progress)
    for stage in stages:
        with _timed(seconds, stage.name):
            stage.finish()
            stage.derive()


def _go_over_frames(stages: Sequence[Stage], trial: Trial, seconds: dict[str, float], progress: bool) -> None:
    pictures = any(stage.reads_frames for stage in stages)
    order = np.arange(len(trial))
    if any(stage.backward for stage in stages):
        order = order[::-1]
    size = _PICTURES if pictures else _NUMBERS
    batches = [order[first : first + size] for first in range(0, len(order), size)]
    *early, last = stages

    def begin(indices: np.ndarray) -> Batch:
        """Pictures, and all stages but the last one, which may still be busy with the batch before."""
        with torch.inference_mode():  # of this thread
            batch = Batch(indices)
            if pictures:
                with _timed(seconds, "decoding"):
                    batch.frames = read_frames(trial.inputs.recording[indices])
            for stage in early:
                _step(stage, batch, seconds)
        return batch

    ahead = trial.inputs.alone and pictures and bool(early) and torch.get_num_threads() > 1
    begun = _ahead(begin, batches) if ahead else (begin(indices) for indices in batches)
    bar = tqdm(total=len(order), desc="frames" if pictures else "fields", unit="frame", disable=not progress)
    # Closed also after an error: the recording must not be while another thread reads from it.
    with closing(begun), bar:
        for batch in begun:
            _step(last, batch, seconds)
            bar.update(len(batch.indices))
            del batch  # before the batch after the next one is read


def _step(stage: Stage, batch: Batch, seconds: dict[str, float]) -> None:
    with _timed(seconds, stage.name):
        batch.keep(stage, stage.step(batch))


def _onnx_runtime(engine: str, device: str) -> "OnnxRuntime | None":
    if engine == "torch":
        return None
    if engine != "onnx":
        raise FingerflowError(f"the engine {engine!r} is not known; choose torch or onnx")
    if device not in ("auto", "cpu"):
        raise FingerflowError(f"the engine onnx computes on the processor, not on {device!r}; choose auto or cpu")
    from fingerflow.export.runtime import OnnxRuntime  # what it needs to load is not needed otherwise

    return OnnxRuntime(torch.get_num_threads())


def _ahead(act: Callable[[_Given], _Result], given: Iterable[_Given]) -> Generator[_Result, None, None]:
    """As map, but the next result is under way, in a thread of its own, while one is in use.

    Closing it waits for what is under way.
    """
    with ThreadPoolExecutor(max_workers=1) as worker:
        coming: Future[_Result] | None = None
        for some in given:
            # Waited for before the one behind it begins: two results are alive at a time, not three.
            result = [] if coming is None else [coming.result()]
            coming = worker.submit(act, some)
            if result:
                yield result.pop()
        if coming is not None:
            yield coming.result()


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    start = time.perf_counter()
    try:
        yield
    finally:
        seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - start
