"""Run of the pipeline: from a scene file to a labelled data set."""

import json
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import numpy as np
import torch
import xarray as xr
from threadpoolctl import ThreadpoolController
from tqdm import tqdm

from fingerflow import __version__
from fingerflow.pipeline.plan import VARIABLES, Plan, plan
from fingerflow.pipeline.reuse import STAGES, TAKEN_OVER, reasons_to_compute, record, stage_keys
from fingerflow.pipeline.stages.preparation.inputs import Inputs, open_inputs, read_frames
from fingerflow.pipeline.stages.stage import Batch, RunContext, Stage
from fingerflow.recordings.identity import identity_of
from fingerflow.results.atomic_write import keep_others, spare, written_atomically
from fingerflow.results.deviations import stated, withhold
from fingerflow.results.free_space import check_disk, check_memory, size_of_results
from fingerflow.results.result import is_result, open_own, open_result
from fingerflow.results.store import FileStore, MemoryStore, Store
from fingerflow.schema.scene import Scene, load_scene

_PICTURES = 16  # frames per batch; as many again are decoded ahead
_NUMBERS = 64  # frames per batch in a pass without images
_libraries = cache(ThreadpoolController)  # with threads; to search for them takes as long as a frame


def process(
    scene: Scene | str | Path, outputs: Iterable[str] | None = None, device: str = "auto", progress: bool = False,
    engine: str = "auto", to: str | Path | None = None, overwrite: bool = False, earlier: str | Path | None = None,
) -> xr.Dataset:  # fmt: skip
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
    file = None if to is None else Path(to)
    loaded = scene if isinstance(scene, Scene) else load_scene(Path(scene))
    dataset = compute(loaded, file, outputs, device, progress, engine, overwrite, earlier)
    return dataset if file is None else open_own(file)


def compute(
    scene: Scene, to: Path | None, outputs: Iterable[str] | None = None, device: str = "auto", progress: bool = False,
    engine: str = "auto", overwrite: bool = False, earlier: str | Path | None = None,
) -> xr.Dataset:  # fmt: skip
    """Compute a scene into the file `to`, and return an empty data set; without a file, return the results.

    The file is left closed: opening it, as `process` does, takes longer than a stage of a small recording.
    """
    if to is not None:
        spare(to, *scene.files())
        keep_others(to, is_result, overwrite)
    planned = plan(None if outputs is None else [outputs] if isinstance(outputs, str) else list(outputs), scene)
    inputs = open_inputs(scene, device, engine)
    # Products of matrices are small here: threads of BLAS would take longer, and wait for the next one at full load.
    with torch.inference_mode(), inputs.recording, _libraries().limit(limits=1, user_api="blas"):
        possible = (variable for stage in planned.stages for variable in stage.gives)
        asked = (variable for variable in possible if variable.unasked or variable.name in planned.requested)
        size = size_of_results(asked, len(inputs.times), scene.tracking.points)
        variables = stated(VARIABLES, inputs.recording.takes_from_other_frames)
        if to is None:
            check_memory(size)
            store = MemoryStore(variables, len(inputs.times))
            _run(planned, inputs, store, progress, earlier)
            return store.dataset
        check_disk(to, size)
        with written_atomically(to) as part, FileStore(variables, len(inputs.times), part) as file:
            _run(planned, inputs, file, progress, earlier)
        return xr.Dataset()


def _run(planned: Plan, inputs: Inputs, store: Store, progress: bool, earlier: str | Path | None) -> None:
    """Run all passes of the plan and write the results to the store; stages that an `earlier` result has are copied,
    not run.
    """
    seconds: dict[str, float] = {}
    stages: dict[type[Stage], Stage] = {}
    trial = RunContext(inputs, store, planned.stages, planned.requested, stages)
    reuse: dict[str, str] = {}
    computed = {stage.name: "" for stage in planned.stages}
    with ExitStack() as held:
        # If only forces are processed, no frame is read and the recording needs no identity.
        recording = identity_of(inputs.recording) if any(stage.reads_frames for stage in planned.stages) else ""
        keys = stage_keys(planned, inputs, recording)
        if earlier is not None:
            path = Path(earlier)
            earlier_result = held.enter_context(open_result(path))
            computed = reasons_to_compute(earlier_result, path, planned, keys, inputs)
            names = sorted({stage.name for stage in planned.stages} - computed.keys())
            reuse[TAKEN_OVER] = json.dumps({"from": str(path), "stages": names, "computed": computed})
        for kinds in planned.passes():
            for stage_class in kinds:
                stages[stage_class] = stage_class(trial)
                if stage_class.name not in computed:
                    with _timed(seconds, stage_class.name):
                        stages[stage_class].restore(earlier_result)
            _pass([stages[kind] for kind in kinds if kind.name in computed], trial, seconds, progress)
    if inputs.recording.takes_from_other_frames is not None:
        withhold(store, VARIABLES)
    scene = inputs.scene
    attributes = {
        "title": "fingertip on glass",
        "fingerflow_version": __version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "settings": scene.as_json(),
        "strain_measure": scene.fields.strain,
        "engine": inputs.engine.name,
        "warnings": json.dumps([*inputs.warnings, *(text for stage in stages.values() for text in stage.warnings)]),
        STAGES: record(keys, stages, store),
        "stage_seconds": json.dumps({name: round(value, 4) for name, value in seconds.items()}),
        "mm_per_px": inputs.mm_per_px,
        "topography_to_contact": json.dumps(inputs.geometry.topography_to_contact.tolist()),
        "frames": str(scene.recording.frames),
        **reuse,
        **({"recording": recording} if recording else {}),
    }
    store.finish(inputs.times, np.arange(len(inputs.times)) + scene.recording.first_frame, attributes)


def _pass(stages: Sequence[Stage], trial: RunContext, seconds: dict[str, float], progress: bool) -> None:
    """Run the stages of one pass over the frames: begin each stage, process all batches of frames, and finish each
    stage; add the time that each stage takes to `seconds`.
    """
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


def _go_over_frames(stages: Sequence[Stage], trial: RunContext, seconds: dict[str, float], progress: bool) -> None:
    """Run the steps of the stages of a pass over all batches of frames; with several threads, all stages but the last
    one compute the next batch in a thread of their own.
    """
    pictures = any(stage.reads_frames for stage in stages)
    order = np.arange(len(trial))
    if any(stage.backward for stage in stages):
        order = order[::-1]
    size = _PICTURES if pictures else _NUMBERS
    batches = [order[first : first + size] for first in range(0, len(order), size)]
    *early, last = stages

    def begin(indices: np.ndarray) -> Batch:
        batch = Batch(indices)
        if pictures:
            with _timed(seconds, "decoding"):
                batch.frames = read_frames(trial.inputs.recording[indices])
        with torch.inference_mode():  # inference mode holds per thread
            for stage in early:
                _step(stage, batch, seconds)
        return batch

    bar = tqdm(total=len(order), desc="frames" if pictures else "fields", unit="frame", disable=not progress)
    ahead = pictures and (early or trial.inputs.device.type != "cpu") and torch.get_num_threads() > 1
    # The executor waits for its thread also after an error, so that the recording is not closed while it reads.
    with bar, ThreadPoolExecutor(max_workers=1) as worker:
        coming: Future[Batch] | None = None
        for number, indices in enumerate(batches):
            batch = begin(indices) if coming is None else coming.result()
            # Submitted once the batch before is there: then two are in memory at a time, not three.
            coming = worker.submit(begin, batches[number + 1]) if ahead and batches[number + 1 :] else None
            _step(last, batch, seconds)
            bar.update(len(indices))
            del batch


def _step(stage: Stage, batch: Batch, seconds: dict[str, float]) -> None:
    with _timed(seconds, stage.name):
        batch.steps[type(stage)] = stage.step(batch)


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    start = time.perf_counter()
    try:
        yield
    finally:
        seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - start
