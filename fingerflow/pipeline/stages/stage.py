"""Base class of pipeline stages, with the inputs and outputs of a stage and the methods that a run calls."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, TypeVar, cast

import numpy as np
import xarray as xr

from fingerflow.kernels.array_types import Array, Mask, Numbers
from fingerflow.pipeline.stages.preparation.inputs import Inputs
from fingerflow.results.store import Store
from fingerflow.schema.scene import Scene
from fingerflow.schema.variable_record import LABELS, Variable
from fingerflow.schema.variables import USABLE
from fingerflow.tracker.vibration import FRAMES_READ

S = TypeVar("S", bound="Stage")


@dataclass
class Batch:
    """Batch of consecutive frames, with the results that the stages of one pass have computed from it.

    Attributes:
        indices: (n,) frame numbers, from 0 for the first selected frame; ascending or descending by one.
        frames: (n, H, W) pictures; None where no stage of the pass reads them.
        steps: what the method `step` of each earlier stage of this pass returned.
    """

    indices: Numbers
    frames: Any = None
    steps: dict[type["Stage"], Any] = field(default_factory=dict)


@dataclass
class RunContext:
    """Context of a run for one recording, shared by all stages: inputs, results so far, plan and stages."""

    inputs: Inputs
    results: Store
    planned: tuple[type["Stage"], ...]
    requested: frozenset[str]  # variables that were requested by name, or that a stage reads
    stages: Mapping[type["Stage"], "Stage"]  # stages of this and earlier passes

    def stage(self, stage_class: type[S]) -> S:
        """Return the instance of a stage class in this run."""
        return cast(S, self.stages[stage_class])

    def stores(self, variable: Variable) -> bool:
        """Return whether this run stores a variable of a planned stage: an optional one only where it is asked for."""
        return variable.unasked or variable.name in self.requested

    def __len__(self) -> int:
        return len(self.inputs.times)


class Stage:
    """Base class of processing stages; the pipeline finds every subclass that a file of the folder `stages` defines.

    The pipeline goes over the frames once for all stages that depend only on each other's steps, and again for the
    stages after them. It calls `begin` of each stage in the order of dependencies, `step` batch by batch, `finish`, and
    `derive`. A stage writes results of points and triangles to `RunContext.results` as they are computed; for all
    frames it holds only a few numbers a frame, in `series`. Later stages read both from `RunContext.results`.

    Attributes:
        name: in the plan, and in the seconds that a result states.
        gives: variables that it computes.
        reads: optional variables of other stages that it reads; the plan then computes them.
        needs: keys that the scene must have (`Scene.has`).
        same_pass: stages of the same pass whose step of the same frames comes before its own.
        after: stages that must be finished before it begins.
        reads_frames: True if `step` reads pictures.
        settings: keys of the scene on which its results depend, besides results of other stages, "fields.strain"; a
            table stands for all of its keys, "recording.times" for the times of the frames, whatever their source.
        backward: whether the frames are processed from the last one to the first one.
        restored: False if later stages need more of it than `restore` brings back from an earlier result.
        warnings: messages to the user; of the instance.
        stored: variables of `gives` that this run stores.
        series: values (frames, ...) by name of the variables that have a few numbers a frame, NaN until they are set;
            `derive` stores them, with the attributes in `about`.
    """

    name: ClassVar[str]
    gives: ClassVar[tuple[Variable, ...]]
    reads: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[tuple[str, ...]] = ()
    same_pass: ClassVar[tuple[type["Stage"], ...]] = ()
    after: ClassVar[tuple[type["Stage"], ...]] = ()
    reads_frames: ClassVar[bool] = False
    settings: ClassVar[tuple[str, ...]] = ()
    restored: ClassVar[bool] = True
    backward = False

    def __init__(self, trial: RunContext) -> None:
        self.trial = trial
        self.warnings: list[str] = []
        self.inputs = trial.inputs
        self.results = trial.results
        self.about: dict[str, Mapping[str, Any]] = {}
        self.stored = tuple(filter(trial.stores, self.gives))
        self.series = {
            variable.name: np.full((len(trial), *(len(LABELS[dim]) for dim in variable.dims[1:])), np.nan)
            for variable in self.stored
            if variable.dims[0] == "frame" and variable.dtype == "f8" and LABELS.keys() >= {*variable.dims[1:]}
            if variable.formula is None and all(map(trial.inputs.scene.has, variable.needs))
        }

    @classmethod
    def variant(cls, scene: Scene) -> type["Stage"]:
        """Return the class that runs for a scene: this class, or a subclass that a setting selects. No other stage may
        depend on a stage with such subclasses.
        """
        return cls

    @property
    def first_frame(self) -> int:
        """Return the number in the file of the first selected frame."""
        return self.inputs.scene.recording.first_frame

    @cached_property
    def usable(self) -> Mask:
        """Return the mask (frames,) of the frames that count, once they are checked."""
        return self.results["frame_status"][:] == USABLE

    def known(self, name: str) -> Array | None:
        """Return the values of a result of an earlier stage; None where this trial has none."""
        return self.results[name][:] if name in self.results else None

    def begin(self) -> None:
        """Prepare the stage before the first frame. Raises FingerflowError for errors that the user can correct."""

    def step(self, batch: Batch) -> Any:
        """Compute the results of a batch of frames; later stages of the pass get what it returns (`Batch.steps`)."""

    def finish(self) -> None:
        """Compute the results that need all frames, and add warnings, after the last batch."""

    def restore(self, earlier: xr.Dataset) -> None:
        """Copy results and warnings of the stage from an earlier result, instead of computing them by `begin` to
        `derive`.
        """
        self.warnings += json.loads(earlier.attrs["stages"])[self.name]["warnings"]
        for variable in self.stored:
            if variable.name in earlier:
                values = earlier[variable.name]
                sizes = {str(dim): size for dim, size in values.sizes.items() if dim != "frame"}
                stated = {name: value for name, value in values.attrs.items() if not name.startswith("flag_")}
                stored = self.results.create(variable.name, stated, **sizes)
                for first in range(0, stored.shape[0], FRAMES_READ):
                    stored[first : first + FRAMES_READ] = values[first : first + FRAMES_READ].values

    def derive(self) -> None:
        """Store the series after `finish`, and compute the variables that are formulas of others."""
        for name, values in self.series.items():
            self.results.put(name, values, self.about.get(name))
        for variable in self.stored:
            if variable.formula is not None and all(name in self.results for name in variable.of):
                # A quotient with the divisor 0 is NaN or infinite, without a warning.
                with np.errstate(divide="ignore", invalid="ignore"):
                    values = variable.formula(*(self.results[name][:] for name in variable.of))
                self.results.put(variable.name, values)
