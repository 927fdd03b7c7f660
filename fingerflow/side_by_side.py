"""Several recordings side by side: what they ask of one graph at the same time, it is asked once.

Each is computed in a thread of its own, as if it were alone, until it calls a graph. There it waits for the others, and
when all wait, calls of the same graph with the same settings become one: frames one after the other, fewer points
filled up with points that are NaN. An accelerator, whose time for a few hundred points is that of starting its kernels,
starts them once for all recordings. Which calls are joined depends on what the recordings ask, and not on time.

A processor gains nothing: its compiled kernels follow the points without a graph.
"""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import partial
from threading import Condition
from typing import Any, TypeVar, cast

import torch
from torch import Tensor, nn
from torch.utils import _pytree as tree

from fingerflow.graphs.calls import Call, StandIn, axes_that_differ, filled_up, settings_of
from fingerflow.graphs.contact import ContactGraph
from fingerflow.graphs.key import KeyGraph
from fingerflow.graphs.track import AgreementGraph, DeformationGraph, TrackGraph
from fingerflow.stages.inputs import Engine

# Those that are called all the time, and whose every argument may be of one frame or of each. The fields are asked for
# 64 frames at once, which keeps an accelerator busy as it is. Those of the smallest steps come first: recordings whose
# points need more of them catch up, and the next larger step is one of all again.
_JOINED = (TrackGraph, AgreementGraph, DeformationGraph, KeyGraph, ContactGraph)

M = TypeVar("M", bound=nn.Module)
Result = TypeVar("Result")


def side_by_side(acts: Sequence[Callable[[Engine], Result]]) -> list[Result]:
    """Results of acts, each given its own engine for graphs, and run in a thread of its own.

    What one of them raises, the others do not notice; when all have ended, the first such error is raised. Ctrl-C ends
    each of them where it calls a graph next.
    """
    if not acts:
        return []
    together = _Together(len(acts))

    def run(act: Callable[[Engine], Result], place: int) -> Result:
        try:
            return act(partial(together.member, place))
        finally:
            together.leave()

    with ThreadPoolExecutor(len(acts)) as threads:
        try:
            ended = [threads.submit(run, act, place) for place, act in enumerate(acts)]
            wait(ended)
        except BaseException:  # as of Ctrl-C, or where there is no thread for one, for which others would wait
            together.stop()
            raise
    return [one.result() for one in ended]


class _Stopped(BaseException):
    """Nobody asks for the results any more; no Exception, which would be taken for one of the recording's."""


class _Together:
    """Recordings in so many threads, each of which waits for a call of a graph, computes, or has left."""

    def __init__(self, members: int) -> None:
        self._members = members
        self._waiting: list[_Asked] = []
        self._stopped = False
        self._turn = Condition()
        self._point_axes: dict[Any, dict[str, list[int]]] = {}

    def member(self, place: int, module: M) -> M:
        """The module that one of them calls in place of this one."""
        return cast(M, _Joining(module, self, place)) if isinstance(module, _JOINED) else module

    def ask(self, asked: "_Asked") -> Any:
        """The result of a call, when all members have asked for theirs."""
        with self._turn:
            self._waiting.append(asked)
            while not asked.answered:
                if self._stopped:
                    raise _Stopped
                if len(self._waiting) < self._members:
                    self._turn.wait()
                    continue
                self._answer_next()
                self._turn.notify_all()
        error, asked.error = asked.error, None
        try:
            if error is not None:
                raise error
            return asked.result
        finally:
            del error  # it knows this frame, and in a circle the tensors of a call would stay

    def leave(self) -> None:
        """A member asks no more."""
        with self._turn:
            self._members -= 1
            self._turn.notify_all()  # one that waits answers: modes of torch, as that of inference, are a thread's own

    def stop(self) -> None:
        """No member asks with success from now on."""
        with self._turn:
            self._stopped = True
            self._turn.notify_all()

    def _answer_next(self) -> None:
        """Answers the calls whose turn it is; all members wait."""
        now = min(asked.turn for asked in self._waiting)
        waiting = sorted((asked for asked in self._waiting if asked.turn == now), key=lambda one: one.place)
        self._waiting = [asked for asked in self._waiting if asked.turn != now]
        groups: dict[Any, list[_Asked]] = {}
        for asked in waiting:
            groups.setdefault(asked.key, []).append(asked)
        for group in groups.values():
            self._answer(group)

    def _answer(self, group: list["_Asked"]) -> None:
        try:
            results = self._joined(group) if len(group) > 1 else [group[0].made()]
        except BaseException as error:  # of whatever kind: who waits for an answer would wait for ever
            if len(group) == 1:
                group[0].error, group[0].answered = error, True
                return
        else:
            for asked, result in zip(group, results, strict=True):
                asked.result, asked.answered = result, True
            return
        # Whose it is shows when each is made by itself: memory, or what one of them asks. Not before the error is gone,
        # which holds the memory of the call that failed.
        for asked in group:
            self._answer([asked])

    def _joined(self, group: list["_Asked"]) -> list[Any]:
        """The results of calls that are made as one."""
        first, room = group[0], max(asked.call.points for asked in group)
        given = [filled_up(asked.of_every_frame(), asked.call.tensor_axes, room) for asked in group]
        result = first.made([torch.cat(some) for some in zip(*given, strict=True)])
        paths, structure = tree.tree_flatten_with_path(result)
        names, leaves = [tree.keystr(path) for path, _ in paths], [leaf for _, leaf in paths]
        along = {} if all(asked.call.points == room for asked in group) else self._along(first)
        parts, done = [], 0
        for asked in group:
            frames = slice(done, done := done + asked.frames)
            own = [leaf[frames] if isinstance(leaf, Tensor) else leaf for leaf in leaves]
            for place, name in enumerate(names):
                for axis in along.get(name, ()):
                    own[place] = own[place].narrow(axis, 0, asked.call.points)
            parts.append(tree.tree_unflatten(own, structure))
        return parts

    def _along(self, asked: "_Asked") -> dict[str, list[int]]:
        """Along which axes points lie in a result, by the names of its leaves: seen from shapes, without values."""
        if asked.key not in self._point_axes:
            call = asked.call
            found = []
            for room in (call.points, call.points + 1):
                tensors = filled_up([one.to("meta") for one in call.tensors], call.tensor_axes, room)
                found.append(tree.tree_flatten_with_path(asked.made(tensors))[0])
            self._point_axes[asked.key] = {
                tree.keystr(path): axes_that_differ(one, other)
                for (path, one), (_, other) in zip(*found, strict=True)
                if isinstance(one, Tensor)
            }
        return self._point_axes[asked.key]


class _Asked:
    """A call that a member waits for.

    Attributes:
        place: of the member that waits for it.
        turn: the smaller, the sooner it is answered.
        key: of those that can be made as one with it.
        frames: that it is of.
    """

    def __init__(self, module: nn.Module, settings: str, method: str, call: Call, place: int) -> None:
        self._method = getattr(module, method)
        self.call, self.place, self.turn = call, place, _JOINED.index(type(module))
        self.frames = max(len(one) for one in call.tensors)
        self.answered = False
        self.result: Any = None
        self.error: BaseException | None = None
        kinds = [
            (value.dtype, value.device, *_beside(value, axis)) if isinstance(value, Tensor) else repr(value)
            for value, axis in zip(call.values, call.axes, strict=True)
        ]
        self.key = (type(module), settings, method, repr(call.structure), tuple(kinds))

    def of_every_frame(self) -> list[Tensor]:
        """Its tensors, of what is the same in all frames as many as there are frames."""
        given = self.call.tensors
        return [one if len(one) == self.frames else one.expand(self.frames, *one.shape[1:]) for one in given]

    def made(self, tensors: Iterable[Tensor] | None = None) -> Any:
        """The call itself, or with other tensors."""
        return self._method(**self.call.with_tensors(self.call.tensors if tensors is None else list(tensors)))


class _Joining(StandIn):
    """The attributes of a module, and its methods joined with what other members ask of theirs."""

    def __init__(self, module: nn.Module, together: _Together, place: int) -> None:
        super().__init__(module)
        self._together, self._place = together, place
        self._settings = repr(settings_of(module))

    def _answer(self, method: str, *arguments: Any, **named: Any) -> Any:
        call = Call.of(self._module, method, arguments, named)
        return self._together.ask(_Asked(self._module, self._settings, method, call, self._place))


def _beside(tensor: Tensor, axis: int | None) -> list[int]:
    """The shape but for frames and points."""
    return [size for place, size in enumerate(tensor.shape) if place not in (0, axis)]
