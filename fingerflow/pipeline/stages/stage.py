"""What a stage is: what it needs, what it gives, and its three parts, which the pipeline calls."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fingerflow.pipeline.stages.trial.inputs import Inputs
from fingerflow.results.store import Store
from fingerflow.schema.variables import Variable

S = TypeVar("S", bound="Stage")
_COPIED = 64  # frames at a time


@dataclass
class Batch:
    """Consecutive frames on their way through the stages of one pass, in the order in which these want them.

    Attributes:
        indices: (n,) their numbers, from 0 for the first frame that counts; up or down by one.
        frames: (n, H, W) the pictures, where a stage of the pass reads them.
    """

    indices: NDArray[np.intp]
    frames: NDArray[np.generic] | None = None
    _steps: dict[type["Stage"], Any] = field(default_factory=dict)

    def keep(self, stage: "Stage", result: Any) -> None:
        """What a stage's step has given, for the stages beside it."""
        self._steps[type(stage).place()] = result

    def of(self, stage: type["Stage"]) -> Any:
        """What the step of a stage beside has given for these frames."""
        return self._steps[stage]


@dataclass
class Trial:
    """A scene on its way: what it is computed from, what was asked for, and what is there so far."""

    inputs: Inputs
    results: Store
    planned: tuple[type["Stage"], ...]
    asked: frozenset[str]  # variables, by name or because a stage reads them
    stages: Mapping[type["Stage"], "Stage"]  # those that run or have run, by their `Stage.place`

    def stage(self, kind: type[S]) -> S:
        """The stage of this class, which runs beside or before."""
        found = self.stages[kind]
        assert isinstance(found, kind)
        return found

    def __len__(self) -> int:
        return len(self.inputs.times)


class Stage:
    """One step of the computation. A file of this folder holds it; that is all it takes.

    The pipeline goes over the frames once for all stages that need nothing but each other's steps, and once more for
    those that come after them. It calls `begin` of each, in the order of their needs, `step` with batch after batch,
    and `finish`. A stage writes results of frames to `Trial.results` as they come: what it holds for all frames is a
    few numbers a frame.

    Attributes:
        name: in the plan and in the seconds that a result states.
        gives: the results.
        reads: results of others, of those that are computed only where they are asked for.
        needs: keys of the scene without which it cannot run (`Scene.has`).
        beside: stages whose step of the same frames comes before its own.
        after: stages that must be finished before it begins.
        reads_frames: whether `step` wants pictures.
        follows_border: whether it wants points on both sides of the border of the contact, from the first frame on.
        instead: of its class, for scenes of a kind that says so (`Kind.instead`): what it gives, another way.
        settings: keys of the scene on which its results depend beside what other stages give, "fields.strain"; a
            table stands for all of its keys, "recording.times" for the times of the frames, wherever they come from.
        restored: whether `restore` brings back all that later stages want of it, from an earlier result.
        warnings: of the instance, what a user should read.
    """

    name: ClassVar[str]
    gives: ClassVar[tuple[Variable, ...]]
    reads: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[tuple[str, ...]] = ()
    beside: ClassVar[tuple[type["Stage"], ...]] = ()
    after: ClassVar[tuple[type["Stage"], ...]] = ()
    reads_frames: ClassVar[bool] = False
    follows_border: ClassVar[bool] = False
    instead: ClassVar[bool] = False
    settings: ClassVar[tuple[str, ...]] = ()
    restored: ClassVar[bool] = False

    def __init__(self, trial: Trial) -> None:
        self.trial = trial
        self.warnings: list[str] = []
        self.inputs = trial.inputs
        self.results = trial.results

    @classmethod
    def place(cls) -> type["Stage"]:
        """The class by which other stages know it: its own, or the one that it stands in for."""
        return next(kind for kind in cls.__mro__ if issubclass(kind, Stage) and not kind.instead)

    @classmethod
    def depends_on(cls, planned: Sequence[type["Stage"]]) -> Any:
        """What of the plan its results depend on, beside the settings: a value of JSON."""
        return None

    @property
    def backward(self) -> bool:
        """Whether frames come from the last to the first one."""
        return False

    def begin(self) -> None:
        """Opens what it needs. Raises FingerflowError for what the user can put right."""

    def step(self, batch: Batch) -> Any:
        """Results of these frames; what it returns, stages beside it get by `Batch.of`.

        It may be a generator of engine calls that several recordings share (`engines.together`).
        """

    def finish(self) -> None:
        """Results that need all frames, and warnings."""

    def restore(self, earlier: xr.Dataset) -> None:
        """In place of begin, step, finish and derive: its results as an earlier result has them."""
        for variable in self.gives:
            if variable.name in earlier and (variable.unasked or variable.name in self.trial.asked):
                values = earlier[variable.name]
                sizes = {str(dim): size for dim, size in values.sizes.items() if dim != "frame"}
                given = {str(name): one for name, one in values.attrs.items() if not str(name).startswith("flag_")}
                stored = self.results.create(variable.name, given, **sizes)
                for first in range(0, stored.shape[0], _COPIED):
                    stored[first : first + _COPIED] = values[first : first + _COPIED].values

    def derive(self) -> None:
        """Results that are formulas of others, after `finish`."""
        for variable in self.gives:
            wanted = variable.unasked or variable.name in self.trial.asked
            if variable.formula is not None and wanted and all(name in self.results for name in variable.of):
                with np.errstate(divide="ignore", invalid="ignore"):  # a quotient by nothing is NaN or infinite
                    values = variable.formula(*(self.results[name][:] for name in variable.of))
                self.results.put(variable.name, values)
