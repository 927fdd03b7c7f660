"""Run of the pipeline: from a scene file to a labelled data set."""

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
from fingerflow.pipeline.stages.preparation.inputs import Inputs, open_inputs, read_frames
from fingerflow.pipeline.stages.stage import Batch, RunContext, Stage
from fingerflow.recordings.identity import identity_of
from fingerflow.results.atomic_write import keep_others, spare, written_atomically
from fingerflow.results.deviations import stated, withhold
from fingerflow.results.free_space import check_disk, check_memory, size_of_results
from fingerflow.results.result import is_result, open_own, open_result
from fingerflow.results.store import FileStore, MemoryStore, Store
from fingerflow.schema.scene import Scene, load_scene
from fingerflow.schema.variable_record import Variable

if TYPE_CHECKING:
    from fingerflow.export.runtime import OnnxRuntime

_PICTURES = 8  # frames per batch; as many again are decoded ahead
_NUMBERS = 64  # frames per batch in a pass without images
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
    """Compute the requested `outputs` of a scene, running only the stages needed for these outputs.

    Args:
        scene: from :func:`~fingerflow.schema.scene.load_scene`, or the path of its file.
        outputs: names of variables, or one name, see ``fingerflow.pipeline.plan.OUTPUTS``; None for the default outputs
            of the scene's kind that its settings allow.
        device: "auto" (CUDA where available), "cpu", "cuda" ...
        progress: show a progress bar.
        engine: computes contact, points and fields (`fingerflow.engines`): "native", the compiled library on the
            processor; "torch", the modules of `fingerflow.graphs` on any device; "onnx", the same modules by ONNX
            Runtime on the processor; "auto", native where it is available for the settings and torch elsewhere. Results
            of the engines agree to rounding, and state the engine.
        to: HDF5/NetCDF4 file to which results are written as they are computed, so that memory does not grow with the
            number of frames. The file appears when it is complete. None keeps results in memory.
        overwrite: allow replacing a file that is no result of `process`. An input is never replaced.
        earlier: result of the same recording. Stages whose settings and inputs have not changed are copied from it, and
            only the others are computed. The attribute "taken_over" lists them; the data are the same, bit for bit. It
            may be the file that is written.

    Returns:
        Data set with the variables of the stages that ran (`fingerflow.schema.variables`). With `to`, values are read
        from the file on access.

    Raises:
        FingerflowError: for every error that the user can correct; the message names the file and the value.
    """
    with torch.inference_mode():
        if to is None:
            return run_alone(
                _in_memory(scene, outputs, device, engine, _RunOptions(progress, ahead=True, earlier=earlier))
            )
        run_alone(steps_to(Path(to), scene, outputs, device, engine, overwrite, earlier, progress, ahead=True))
    return open_own(Path(to))


def process_together(
    scenes: Sequence[Scene | str | Path],
    outputs: Iterable[str] | None = None,
    device: str = "auto",
    engine: str = "auto",
    to: Sequence[str | Path] | None = None,
    overwrite: bool = False,
) -> list[xr.Dataset]:
    """Process several recordings concurrently, so that engine calls are batched, and return their results.

    Simultaneous calls of the torch engine are batched into one where views have the same size and settings are the
    same. On an accelerator, a call with a few hundred points takes as long as launching its kernels; batching launches
    them once for all recordings. Results agree with those of `process` to rounding. With the compiled library on a
    processor nothing is gained, and results are those of `process`, bit for bit.

    The seconds of a stage that a result states include the time in which the stage waits for other recordings.

    Args:
        scenes: as for `process`; they may differ in numbers of points and frames, and in their settings.
        outputs, device, engine, overwrite: as for `process`.
        to: one file for each scene.

    Returns:
        One data set for each scene.

    Raises:
        FingerflowError: as for `process`. An error in one recording does not affect the others. It is raised after all
            have ended, when the files of the others are complete.
    """
    outputs = outputs if outputs is None or isinstance(outputs, str) else list(outputs)
    if to is None:
        return run_steps([_in_memory(scene, outputs, device, engine, _RunOptions()) for scene in scenes])
    files = [Path(path) for path in to]
    given = zip(files, scenes, strict=True)
    run_steps([steps_to(path, scene, outputs, device, engine, overwrite) for path, scene in given])
    return [open_own(path) for path in files]


def run_steps(many: Sequence[Steps[_Result]]) -> list[_Result]:
    """Run several generators made by `steps_to` concurrently (`engines.together`), and return their results."""
    # Entered once around all generators: leaving it in one of them would end it for the others.
    with torch.inference_mode():
        return run_together(many)


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
    """Return a generator that processes one recording into a file; `run_steps` runs several generators concurrently.

    With `ahead`, the stages before the last one process the next batch in a second thread. Recordings computed together
    do not use it, as the others would wait for that thread.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(Path(scene))
    spare(to, *scene.files())
    keep_others(to, is_result, overwrite)
    with _prepared(scene, outputs, device, engine) as ready:
        check_disk(to, ready.size)
        frames = len(ready.inputs.times)
        with written_atomically(to) as part, FileStore(ready.variables, frames, part) as file:
            yield from _run(ready, file, _RunOptions(progress, ahead, earlier))


@dataclass(frozen=True)
class _RunOptions:
    """Options of a run: whether to show a progress bar, whether to prepare the next batch of frames in a second thread,
    and the path of an earlier result to reuse, if any.
    """

    progress: bool = False
    ahead: bool = False
    earlier: str | Path | None = None


def _in_memory(
    scene: Scene | str | Path, outputs: Iterable[str] | None, device: str, engine: str, way: _RunOptions
) -> Steps[xr.Dataset]:
    with _prepared(scene, outputs, device, engine) as ready:
        check_memory(ready.size)
        store = MemoryStore(ready.variables, len(ready.inputs.times))
        yield from _run(ready, store, way)
        return store.dataset


@dataclass(frozen=True)
class _PreparedScene:
    """Scene prepared for a run: plan, opened inputs, ONNX runtime, result size in bytes, and variable definitions."""

    plan: Plan
    inputs: Inputs
    runtime: "OnnxRuntime | None"
    size: float
    variables: dict[str, Variable]

    @property
    def engine(self) -> str:
        """Return the name of the engine, as stored in the result."""
        return self.inputs.engine.name if self.runtime is None else "onnx"


@contextmanager
def _prepared(
    scene: Scene | str | Path, outputs: Iterable[str] | None, device: str, engine: str
) -> Iterator[_PreparedScene]:
    scene = scene if isinstance(scene, Scene) else load_scene(Path(scene))
    wanted = plan(None if outputs is None else [outputs] if isinstance(outputs, str) else list(outputs), scene)
    runtime = _onnx_runtime(engine, device)
    inputs = open_inputs(scene, device, engine) if runtime is None else open_inputs(scene, "cpu", modules=runtime)
    with inputs.recording:
        given = (one for stage in wanted.stages for one in stage.gives if one.unasked or one.name in wanted.asked)
        size = size_of_results(given, len(inputs.times), scene.tracking.points)
        yield _PreparedScene(wanted, inputs, runtime, size, stated(VARIABLES, inputs.recording.takes_from_other_frames))


def _run(ready: _PreparedScene, store: Store, way: _RunOptions) -> Steps[None]:
    """Run all passes of the plan and write the results to the store; reusable stages are copied, not run."""
    wanted, inputs, runtime = ready.plan, ready.inputs, ready.runtime
    seconds: dict[str, float] = {}
    stages: dict[type[Stage], Stage] = {}
    trial = RunContext(inputs, store, wanted.stages, wanted.asked, stages)
    said: dict[str, str] = {}
    with ExitStack() as held:
        # If only forces are processed, no frame is read and the recording needs no identity.
        recording = identity_of(inputs.recording) if any(one.reads_frames for one in wanted.stages) else ""
        keys = keys_of(wanted, inputs, ready.engine, recording)
        known: Reused | None = None
        if way.earlier is not None:
            earlier = Path(way.earlier)
            known = reused(held.enter_context(open_result(earlier)), earlier, wanted, keys, inputs)
            said[TAKEN_OVER] = known.as_json()
        for kinds in wanted.passes():
            stages.update({kind: kind(trial) for kind in kinds})
            running = [stages[kind] for kind in kinds]
            if known is not None:
                for stage in running:
                    if type(stage) in known.stages:
                        with _timed(seconds, stage.name):
                            known.restore(stage)
                running = [stage for stage in running if type(stage) not in known.stages]
            yield from _pass(running, trial, seconds, way)
    if inputs.recording.takes_from_other_frames is not None:
        withhold(store, VARIABLES)
    if runtime is not None:
        seconds["export"] = runtime.seconds  # this time is also counted in the stages that exported a graph
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


def _pass(stages: Sequence[Stage], trial: RunContext, seconds: dict[str, float], way: _RunOptions) -> Steps[None]:
    """Run the stages of one pass over the frames: begin each stage, process all batches of frames, and finish each
    stage; add the time that each stage takes to `seconds`.
    """
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


def _go_over_frames(
    stages: Sequence[Stage], trial: RunContext, seconds: dict[str, float], way: _RunOptions
) -> Steps[None]:
    pictures = any(stage.reads_frames for stage in stages)
    order = np.arange(len(trial))
    if any(stage.backward for stage in stages):
        order = order[::-1]
    given = {name: getattr(trial.inputs.scene.views, name) for stage in stages for name in stage.views}
    views = [view for view in given.values() if view is not None]
    size = _PICTURES if pictures else _NUMBERS
    batches = [order[first : first + size] for first in range(0, len(order), size)]
    *early, last = stages

    def read(indices: np.ndarray) -> Batch:
        batch = Batch(indices)
        if pictures:
            with _timed(seconds, "decoding"):
                batch.frames = read_frames(trial.inputs.recording[indices])
            if _decodes_ahead(trial.inputs):
                batch.ahead = {view: trial.inputs.images_ahead(batch.frames, view) for view in views}
        return batch

    def begin(batch: Batch) -> Steps[Batch]:
        """Run all stages of the pass but the last one on a batch of frames, and return the batch; meanwhile the last
        stage may still process the batch before.
        """
        for stage in early:
            yield from _step(stage, batch, seconds)
        return batch

    def begin_alone(indices: np.ndarray) -> Batch:
        with torch.inference_mode():  # inference mode holds per thread
            return run_alone(begin(read(indices)))

    bar = tqdm(total=len(order), desc="frames" if pictures else "fields", unit="frame", disable=not way.progress)
    with bar:
        if way.ahead and pictures and early and torch.get_num_threads() > 1:
            # `closing` waits for the thread also after an error, so that the recording is not closed while the thread
            # reads.
            with closing(_compute_ahead(begin_alone, batches)) as begun:
                for batch in begun:
                    yield from _step(last, batch, seconds)
                    bar.update(len(batch.indices))
                    del batch  # frees the batch before the batch after the next one is read
        else:
            ahead = pictures and _decodes_ahead(trial.inputs)
            with closing(_compute_ahead(read, batches) if ahead else (read(one) for one in batches)) as every:
                for batch in every:
                    yield from begin(batch)
                    yield from _step(last, batch, seconds)
                    bar.update(len(batch.indices))
                    del batch


def _decodes_ahead(inputs: Inputs) -> bool:
    """Return whether a second thread decodes the next batch of frames and uploads its images: True on a GPU, since the
    CPU is free while the GPU computes.
    """
    return inputs.device.type != "cpu"


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
    # Imported here, as the import is slow and needed for this engine only.
    from fingerflow.export.runtime import OnnxRuntime

    return OnnxRuntime(torch.get_num_threads())


def _compute_ahead(act: Callable[[_Given], _Result], given: Iterable[_Given]) -> Generator[_Result, None, None]:
    """Yield `act(item)` for each item, like `map`, while a second thread computes the result for the next item.

    Closing the generator waits for the running computation.
    """
    with ThreadPoolExecutor(max_workers=1) as worker:
        coming: Future[_Result] | None = None
        for some in given:
            # Wait for a result before submitting the next computation: then two results are in memory at a time, not
            # three.
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
