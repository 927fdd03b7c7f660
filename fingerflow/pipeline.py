"""The main job: a scene in, a labelled data set out."""

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import torch
import xarray as xr
from torch import Tensor
from tqdm import tqdm

from fingerflow.errors import FingerflowError
from fingerflow.plan import plan
from fingerflow.result import Outcome, label
from fingerflow.scene import Scene, load_scene
from fingerflow.stages import deformation
from fingerflow.stages.contact import ContactStage
from fingerflow.stages.inputs import Inputs, open_inputs
from fingerflow.stages.loading import load
from fingerflow.stages.slip import find_slip
from fingerflow.stages.tracking import TrackingStage, TrackSeries

if TYPE_CHECKING:
    from fingerflow.export.runtime import OnnxRuntime

_BATCH = 8  # frames in memory at a time, and as many on their way
_Given = TypeVar("_Given")
_Result = TypeVar("_Result")


def process(
    scene: Scene | str | Path,
    outputs: Iterable[str] | None = None,
    device: str = "auto",
    progress: bool = False,
    engine: str = "torch",
) -> xr.Dataset:
    """Computes ``outputs`` of a scene, and only what they need.

    Args:
        scene: from :func:`~fingerflow.scene.load_scene`, or the path of its file.
        outputs: names of variables, or one name, see ``fingerflow.plan.OUTPUTS``; None for all that the scene allows.
        device: "auto" (CUDA where it is there), "cpu", "cuda" ...
        progress: show a bar.
        engine: what runs the modules of `fingerflow.graphs`: "torch" with its compiled kernels, or "onnx", ONNX Runtime
            on the processor, from graphs as an exported bundle has them. The results agree to rounding.

    Returns:
        The data set of :mod:`fingerflow.result`: with what the stages that ran have given.

    Raises:
        FingerflowError: whatever the user can put right, named with its file and value.
    """
    scene = scene if isinstance(scene, Scene) else load_scene(Path(scene))
    wanted = None if outputs is None else [outputs] if isinstance(outputs, str) else list(outputs)
    is_slip = scene.kind == "slip"
    stages = plan(wanted, scene.views.topography is not None, scene.forces is not None, is_slip)
    seconds: dict[str, float] = {}
    runtime = _onnx_runtime(engine, device)
    inputs = open_inputs(scene, device if runtime is None else "cpu")
    if runtime is not None:
        inputs.engine = runtime
    outcome = Outcome(inputs=inputs, seconds=seconds)
    with torch.inference_mode(), inputs.recording:
        with _timed(seconds, "loading"):
            outcome.loading = load(inputs)
        with _timed(seconds, "contact"):
            normal = None if outcome.loading is None else outcome.loading.normal
            contact = ContactStage(inputs, normal, "slip" in stages) if "contact" in stages else None
            tracking = _tracking(inputs, contact, "slip" in stages) if contact and "tracking" in stages else None
        if contact is not None:
            covered = _stream(inputs, contact, tracking, seconds, progress)
            outcome.contact = contact.series
            if "tracking" in stages:
                outcome.tracks = _no_tracks(len(inputs.times)) if tracking is None else tracking.series
        if outcome.tracks is not None and outcome.contact is not None:
            with _timed(seconds, "fields"):
                if "displacement" in stages:
                    outcome.displacement = deformation.displace(inputs, outcome.tracks, covered)
                if "fields" in stages and outcome.displacement is not None:
                    outcome.fields = deformation.fields(inputs, outcome.displacement, outcome.contact)
                if "strain" in stages and outcome.displacement is not None:
                    outcome.strain = deformation.strains(inputs, outcome.displacement, outcome.contact)
            if "slip" in stages and contact is not None:
                with _timed(seconds, "slip"):
                    regions = contact.regions, contact.cell_px
                    outcome.slip = find_slip(inputs, outcome.tracks, outcome.contact, *regions, outcome.loading)
    if runtime is not None:
        seconds["export"] = runtime.seconds  # part of the stages that asked for it
    return label(outcome)


def _onnx_runtime(engine: str, device: str) -> "OnnxRuntime | None":
    if engine == "torch":
        return None
    if engine != "onnx":
        raise FingerflowError(f"the engine {engine!r} is not known; choose torch or onnx")
    if device not in ("auto", "cpu"):
        raise FingerflowError(f"the engine onnx computes on the processor, not on {device!r}; choose auto or cpu")
    from fingerflow.export.runtime import OnnxRuntime  # what it needs to load is not needed otherwise

    return OnnxRuntime(torch.get_num_threads())


def _tracking(inputs: Inputs, contact: ContactStage, is_slip: bool) -> TrackingStage | None:
    """None where no skin touches, so that there is none to follow."""
    region = contact.first_and_largest(inputs.scene.tracking.window_px) if is_slip else contact.largest()
    if region.any():
        return TrackingStage(inputs, region)
    inputs.warnings.append(
        f"no contact was found in frame {contact.reference_frame + inputs.scene.recording.first_frame}, where most of "
        f"it was expected: there are no points and no deformation"
    )
    return None


def _no_tracks(frames: int) -> TrackSeries:
    def nothing(dtype: type) -> np.ndarray:
        return np.empty((frames, 0), dtype)

    return TrackSeries(np.empty((frames, 0, 2)), nothing(np.float32), nothing(np.float32), nothing(np.uint8))


def _stream(
    inputs: Inputs, contact: ContactStage, tracking: TrackingStage | None, seconds: dict[str, float], progress: bool
) -> np.ndarray:
    """Runs the frames through contact and tracking, batch by batch; (F, N) which points the contact covers."""
    scene, recording = inputs.scene, inputs.recording
    order = np.arange(len(recording))
    if tracking is not None and scene.tracking.direction == "backward":
        order = order[::-1]
    covered: dict[int, np.ndarray] = {}
    damaged: list[int] = []

    def begin(indices: np.ndarray) -> tuple[np.ndarray, np.ndarray, Tensor]:
        with torch.inference_mode():  # of this thread
            with _timed(seconds, "decoding"):
                frames = recording[indices].mapped()
            with _timed(seconds, "contact"):
                density_margin = contact.run(indices, frames).density_margin
                damaged.extend(indices[~_whole(scene.views.contact.crop(frames))].tolist())
        return indices, frames, density_margin

    batches = [order[first : first + _BATCH] for first in range(0, len(order), _BATCH)]
    if torch.get_num_threads() == 1 or tracking is None:
        begun = (begin(indices) for indices in batches)
    else:
        begun = _ahead(begin, batches)
    bar = tqdm(total=len(order), desc="frames", unit="frame", disable=not progress)
    # Closed also after an error: the recording must not be while another thread reads from it.
    with closing(begun), bar:
        for indices, frames, density_margin in begun:
            if tracking is not None:
                with _timed(seconds, "tracking"):
                    covered.update(zip(indices.tolist(), tracking.run(indices, frames, density_margin), strict=True))
            bar.update(len(indices))
            del frames, density_margin  # before the batch after the next one is read
    contact.finish()
    if damaged:
        # What is left of such a frame has some area, but not that of the contact.
        for values in vars(contact.series).values():
            values[damaged] = np.nan
        inputs.warnings.append(
            f"{len(damaged)} frames, the first is {min(damaged) + scene.recording.first_frame}, have pixels in the "
            f"contact view that are NaN or infinite: their contact is NaN"
        )
    return np.stack([covered[i] for i in range(len(order))]) if covered else np.zeros((len(order), 0), dtype=bool)


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


def _whole(frames: np.ndarray) -> np.ndarray:
    """(n,) whether every pixel of the frames (n, h, w) is a number."""
    if frames.dtype.kind != "f":
        return np.ones(len(frames), dtype=bool)
    return np.asarray(np.isfinite(frames).all(axis=(1, 2)))


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    start = time.perf_counter()
    try:
        yield
    finally:
        seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - start
