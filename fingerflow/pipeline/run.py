"""The main job: a scene in, a labelled data set out."""

import json
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from inspect import isgenerator
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import torch
import xarray as xr
from tqdm import tqdm

from fingerflow import __version__
from fingerflow.engines.choice import ENGINES
from fingerflow.engines.together import Steps, run_alone, run_together
from fingerflow.errors import FingerflowError
from fingerflow.pipeline.plan import VARIABLES, Plan, plan
from fingerflow.pipeline.reuse import STAGES, TAKEN_OVER, Reused, keys_of, record, reused
from fingerflow.pipeline.stages.stage import Batch, Stage, Trial
from fingerflow.pipeline.stages.trial.inputs import Inputs, open_inputs, read_frames
from fingerflow.recordings.identity import identity_of
from fingerflow.results.atomic_write import keep_others, spare, written_atomically
from fingerflow.results.deviations import stated, withhold
from fingerflow.results.free_space import check_disk, check_memory, size_of_results
from fingerflow.results.result import is_result, open_own, open_result
from fingerflow.results.store import FileStore, MemoryStore, Store
from fingerflow.schema.scene import Scene, load_scene
from fingerflow.schema.variables import Variable

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
    engine: str = "auto",
    to: str | Path | None = None,
    overwrite: bool = False,
    earlier: str | Path | None = None,
) -> xr.Dataset:
    """Computes ``outputs`` of a scene, and only what they need.

    Args:
        scene: from :func:`~fingerflow.schema.scene.load_scene`, or the path of its file.
        outputs: names of variables, or one name, see ``fingerflow.pipeline.plan.OUTPUTS``; None for all that the scene
        allows. device: "auto" (CUDA where it is there), "cpu", "cuda" ...
        progress: show a bar.
        engine: what computes contact, points and fields (`fingerflow.engines`): "native", the compiled library on the
            processor; "torch", the modules of `fingerflow.graphs` on any device; "onnx", the same modules by ONNX
            Runtime on the processor; "auto", native where it serves and torch elsewhere. The results agree to rounding,
            and state which it was.
        to: a file of HDF5/NetCDF4 to which results go as they come, so that memory does not grow with the frames; it
            appears when it is complete. None keeps them in memory.
        overwrite: let that file replace one that is no result of `process`; never an input.
        earlier: a result of the same recording: what does not depend on the settings that have changed since is taken
            from there, and only the rest is computed. The attribute "taken_over" says what; the data are the same, bit
            for bit. It may be the file that is written.

    Returns:
        The data set, with what the stages that ran have given (`fingerflow.schema.variables`); of a file, what
        is looked at is read from it.

    Raises:
        FingerflowError: whatever the user can put right, named with its file and value.
    """
    if to is not None:
        process_to(Path(to), scene, outputs, device, progress, engine, overwrite, earlier)
        return open_own(Path(to))
    with torch.inference_mode():
        return run_alone(_in_memory(scene, outputs, device, engine, _Way(progress, ahead=True, earlier=earlier)))


def process_to(
    to: Path,
    scene: Scene | str | Path,
    outputs: Iterable[str] | None = None,
    device: str = "auto",
    progress: bool = False,
    engine: str = "auto",
    overwrite: bool = False,
    earlier: str | Path | None = None,
) -> None:
    """As `process`, into a file that is not opened again."""
    with torch.inference_mode():
        run_alone(steps_to(to, scene, outputs, device, engine, overwrite, earlier, progress, ahead=True))


def process_together(
    scenes: Sequence[Scene | str | Path],
    outputs: Iterable[str] | None = None,
    device: str = "auto",
    engine: str = "auto",
    to: Sequence[str | Path] | None = None,
    overwrite: bool = False,
) -> list[xr.Dataset]:
    """Results of several recordings that are computed in lock-step.

    Calls of the engine torch that several recordings make at the same time become one: those in pictures of one size
    with the same settings. An accelerator, whose time for a few hundred points is that of starting its kernels, starts
    them once for all recordings. Results agree with those of `process` to rounding. A processor with the compiled
    library gains nothing; there the results are those of `process`, bit for bit.

    The seconds of a stage that a result states include those in which the stage waits for other recordings.

    Args:
        scenes: as for `process`; they may differ in numbers of points and frames, and in what they ask for.
        outputs, device, engine, overwrite: as for `process`.
        to: a file for each scene.

    Returns:
        A data set for each scene.

    Raises:
        FingerflowError: as for `process`. An error of one recording does not touch the others; it is raised when all
            have ended, and the files of the others are there.
    """
    outputs = outputs if outputs is None or isinstance(outputs, str) else list(outputs)
    if to is None:
        return run_steps([_in_memory(scene, outputs, device, engine, _Way()) for scene in scenes])
    files = [Path(path) for path in to]
    given = zip(files, scenes, strict=True)
    run_steps([steps_to(path, scene, outputs, device, engine, overwrite) for path, scene in given])
    return [open_own(path) for path in files]


def run_steps(many: Sequence[Steps[_Result]]) -> list[_Result]:
    """What `steps_to` of several recordings return, as `engines.together.run_together` gives it."""
    with torch.inference_mode():  # around all of them: each would end it for the others
        return [run_alone(many[0])] if len(many) == 1 else run_together(many)


def steps_to(
    to: Path,
    scene: Scene | str | Path,
    outputs: Iterable[str] | None = None,
    device: str = "auto",
    engine: str = "auto",
    overwrite: bool = False,
    earlier: str | Path | None = None,
    progress: bool = False,
    ahead: bool = False,
) -> Steps[None]:
    """`process_to` as one of several recordings, for `run_steps`.

    With `ahead` batches begin in a thread of their own, which other recordings would wait for.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(Path(scene))
    spare(to, *scene.files())
    keep_others(to, is_result, overwrite)
    with _prepared(scene, outputs, device, engine) as ready:
        check_disk(to, ready.size)
        frames = len(ready.inputs.times)
        with written_atomically(to) as part, FileStore(ready.variables, frames, part) as file:
            yield from _run(ready, file, _Way(progress, ahead, earlier))


@dataclass(frozen=True)
class _Way:
    """How a recording is gone through: with a bar, with batches read in a thread of its own, from an earlier result."""

    progress: bool = False
    ahead: bool = False
    earlier: str | Path | None = None


def _in_memory(
    scene: Scene | str | Path, outputs: Iterable[str] | None, device: str, engine: str, way: _Way
) -> Steps[xr.Dataset]:
    with _prepared(scene, outputs, device, engine) as ready:
        check_memory(ready.size)
        store = MemoryStore(ready.variables, len(ready.inputs.times))
        yield from _run(ready, store, way)
        return store.dataset


@dataclass(frozen=True)
class _Ready:
    """An opened scene, what is to be computed of it, by what, how many bytes that gives, and what can be stated."""

    plan: Plan
    inputs: Inputs
    runtime: "OnnxRuntime | None"
    size: float
    variables: dict[str, Variable]

    @property
    def engine(self) -> str:
        """Name of what computes, as results state it."""
        return self.inputs.engine.name if self.runtime is None else "onnx"


@contextmanager
def _prepared(scene: Scene | str | Path, outputs: Iterable[str] | None, device: str, engine: str) -> Iterator[_Ready]:
    scene = scene if isinstance(scene, Scene) else load_scene(Path(scene))
    wanted = plan(None if outputs is None else [outputs] if isinstance(outputs, str) else list(outputs), scene)
    runtime = _onnx_runtime(engine, device)
    inputs = open_inputs(scene, device, engine) if runtime is None else open_inputs(scene, "cpu", modules=runtime)
    with inputs.recording:
        given = (one for stage in wanted.stages for one in stage.gives if one.unasked or one.name in wanted.asked)
        size = size_of_results(given, len(inputs.times), scene.tracking.points)
        yield _Ready(wanted, inputs, runtime, size, stated(VARIABLES, inputs.recording.takes_from_other_frames))


def _run(ready: _Ready, store: Store, way: _Way) -> Steps[None]:
    """Every pass of the plan, into the store, but for what an earlier result has."""
    wanted, inputs, runtime = ready.plan, ready.inputs, ready.runtime
    seconds: dict[str, float] = {}
    stages: dict[type[Stage], Stage] = {}
    trial = Trial(inputs, store, wanted.stages, wanted.asked, stages)
    said: dict[str, str] = {}
    with ExitStack() as held:
        # Of forces alone no picture is looked at.
        recording = identity_of(inputs.recording) if any(one.reads_frames for one in wanted.stages) else ""
        keys = keys_of(wanted, inputs, ready.engine, recording)
        known: Reused | None = None
        if way.earlier is not None:
            earlier = Path(way.earlier)
            known = reused(held.enter_context(open_result(earlier)), earlier, wanted, keys, inputs)
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
            yield from _pass(running, trial, seconds, way)
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
            "engine": ready.engine,
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


def _pass(stages: Sequence[Stage], trial: Trial, seconds: dict[str, float], way: _Way) -> Steps[None]:
    """Takes the frames through these stages, batch by batch."""
    for stage in stages:
        with _timed(seconds, stage.name):
            stage.begin()
    stepping = [stage for stage in stages if type(stage).step is not Stage.step]
    if stepping:
        yield from _go_over_frames(stepping, trial, seconds, way)
    for stage in stages:
        with _timed(seconds, stage.name):
            stage.finish()
            stage.derive()


def _go_over_frames(stages: Sequence[Stage], trial: Trial, seconds: dict[str, float], way: _Way) -> Steps[None]:
    pictures = any(stage.reads_frames for stage in stages)
    order = np.arange(len(trial))
    if any(stage.backward for stage in stages):
        order = order[::-1]
    size = _PICTURES if pictures else _NUMBERS
    batches = [order[first : first + size] for first in range(0, len(order), size)]
    *early, last = stages

    def begin(indices: np.ndarray) -> Steps[Batch]:
        """Pictures, and all stages but the last one, which may still be busy with the batch before."""
        batch = Batch(indices)
        if pictures:
            with _timed(seconds, "decoding"):
                batch.frames = read_frames(trial.inputs.recording[indices])
        for stage in early:
            yield from _step(stage, batch, seconds)
        return batch

    def begin_alone(indices: np.ndarray) -> Batch:
        with torch.inference_mode():  # of this thread
            return run_alone(begin(indices))

    bar = tqdm(total=len(order), desc="frames" if pictures else "fields", unit="frame", disable=not way.progress)
    with bar:
        if way.ahead and pictures and early and torch.get_num_threads() > 1:
            # Closed also after an error: the recording must not be while another thread reads from it.
            with closing(_ahead(begin_alone, batches)) as begun:
                for batch in begun:
                    yield from _step(last, batch, seconds)
                    bar.update(len(batch.indices))
                    del batch  # before the batch after the next one is read
        else:
            for indices in batches:
                batch = yield from begin(indices)
                yield from _step(last, batch, seconds)
                bar.update(len(indices))
                del batch


def _step(stage: Stage, batch: Batch, seconds: dict[str, float]) -> Steps[None]:
    with _timed(seconds, stage.name):
        result = stage.step(batch)
        batch.keep(stage, (yield from result) if isgenerator(result) else result)


def _onnx_runtime(engine: str, device: str) -> "OnnxRuntime | None":
    if engine not in ENGINES:
        raise FingerflowError(f"the engine {engine!r} is not known; choose {', '.join(ENGINES[:-1])} or {ENGINES[-1]}")
    if engine != "onnx":
        return None
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
