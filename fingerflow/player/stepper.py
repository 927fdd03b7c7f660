"""The graphs, frame by frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import onnxruntime as ort

from .arrays import Array, Tensor
from .background import touching
from .bundle import GRAPHS, MEASURING
from .contract.region import region_runs
from .errors import PlayerError
from .handover import Slot
from .motion import Motion, count_known
from .providers import Engine
from .renewal import Renewal
from .scene import Scene, View
from .second_look import SecondLook

_EVERYTHING = 0.98  # of a view: a threshold that this much of it passes is none
# Outputs of `frame` that say which templates to renew, and how; and where to look for a point that is lost.
_FOR_FRAMES_TO_COME = ("stale", "warp", "estimate", "by_neighbours")
LAG = 2  # frames: each begins from what the one before the last has found, whether or not a newer one has ended


class Stepper:
    """State of a stream, and what leads from one frame to the next.

    Two graphs run for a frame. `frame` needs of the frames before only where points are expected: so frames run side by
    side, each from the motion that was known `lag` frames before it. `fields` runs when a frame is finished, one after
    the other, and has states: an output ``next_X`` is the next frame's input ``X``. Other inputs are tensors that the
    graphs `background` and `key` gave and that are held until these run again, the places where points were chosen, and
    constants of the scene.

    Frames begin and are finished in their order. What a frame gives depends on the frames before it and on nothing
    else, neither the clock nor which of them happened to be done.

    Where the scene gives no threshold, nothing touches until one was measured and set.

    Args:
        parallel: frames that run side by side, at most.

    Attributes:
        lag: frames that have begun and are not finished, at most.
        outputs: of both graphs, by name; states are left out.
        threshold: relative intensity loss above which a pixel touches; NaN while unknown.
        glass, dark: (H, W) contact view of the empty glass, and without light.
        measures: whether the threshold is found in frames, by the graph `contact`.
        found, keyed: points found at the last restart, and given to the last key frame.
    """

    def __init__(self, engine: Engine, scene: Scene, background: Array, dark: Array, parallel: int = 1) -> None:
        self._bundle, self._engine = engine.bundle, engine
        self._sessions = {name: engine.frame if name == "frame" else engine.open(name) for name in GRAPHS}
        inputs = {name: self._tensors(name, "get_inputs") for name in GRAPHS}
        outputs = {name: self._tensors(name, "get_outputs") for name in GRAPHS}
        self.threshold = math.nan if scene.given_threshold is None else scene.given_threshold
        self.measures = scene.given_threshold is None and "threshold" in inputs["background"]
        if self.measures:
            self._sessions[MEASURING] = self._open_measuring()
        states = [name for name in inputs["fields"] if f"next_{name}" in outputs["fields"]]
        results = {name: tensor for name, tensor in outputs["fields"].items() if name.removeprefix("next_") == name}
        self.outputs = {
            name: one for name, one in (outputs["frame"] | results).items() if name not in _FOR_FRAMES_TO_COME
        }
        self.found = self.keyed = 0
        self._of_scene: dict[str, Array] = {
            "topography_to_contact": scene.topography_to_contact,
            "mm_per_px": np.array([scene.mm_per_px]),
        }
        self._mask = _region_mask(scene, (1, 1, self._bundle.height, self._bundle.width))
        if "prediction" not in inputs["frame"]:
            raise PlayerError(f"{engine.bundle.files['frame']}: has no input 'prediction'; use a bundle of fingerflow")

        held = {name: tensor for graph in ("background", "key") for name, tensor in outputs[graph].items()}
        self._held = {name: np.zeros(tensor.shape, tensor.dtype) for name, tensor in held.items()}
        self._held_values = {name: self._value(array) for name, array in self._held.items()}
        # Points in a call.
        self._renewed, self._searched = inputs["renew"]["points"].shape[1], inputs["search"]["points"].shape[1]
        self._key_view = np.zeros(inputs["key"]["topography_view"].shape, inputs["key"]["topography_view"].dtype)
        self._frame_inputs = set(inputs["frame"])  # `background` may give more than the `frame` of a recipe takes
        self.parallel, self.lag = parallel, max(LAG, parallel)
        # What a frame writes is not written again while its motion is still asked for.
        sides = range(2 * self.lag)
        self._results = [{name: np.zeros(t.shape, t.dtype) for name, t in outputs["frame"].items()} for _ in sides]
        self._values = [{n: ort.OrtValue.ortvalue_from_numpy(a) for n, a in one.items()} for one in self._results]
        self._expected = [self._room(inputs["frame"]["prediction"]) for _ in sides]
        self._place_type = inputs["frame"]["prediction"].dtype
        self._slots: list[Slot | None] = [None for _ in sides]
        self._numbers = [0 for _ in sides]  # of the frames
        self._jolted: list[Array | None] = [None for _ in sides]  # `SecondLook`
        self._measured = [math.nan for _ in sides]
        self._latest = Motion.at_rest(np.empty((1, 0, 2)), 0)  # after the last frame that was finished
        self._motions = [self._latest for _ in sides]  # what was known when each frame had ended
        constants = self._constants("frame", inputs["frame"], {"prediction", *held})
        self._bindings = [self._binding(side, constants) for side in sides]
        self._begun = self._finished = 0

        # One side of the states is read and the other written, in turns.
        self._states = [{name: self._room(inputs["fields"][name]) for name in states} for _ in range(2)]
        self._fields = {name: np.zeros(tensor.shape, tensor.dtype) for name, tensor in results.items()}
        # Where points were chosen: at the last restart, whatever the key frame is.
        self._choice = {name: self._room(inputs["fields"][name]) for name in ("chosen",) if name in inputs["fields"]}
        constants = self._constants("fields", inputs["fields"], {*states, *self._choice, *outputs["frame"]})
        self._field_bindings = [self._field_binding(side, constants) for side in range(2)]
        self._of_frame = [name for name in inputs["fields"] if name in outputs["frame"]]

        self.glass, self.dark = background, dark
        self.use(self.threshold)

    def warm_up(self) -> None:
        """Runs every graph on an empty frame, twice.

        The first run finds out how much memory it takes, the second lays it out, which makes both slow.
        """
        slot = Slot(self._bundle)
        for _ in range(2):
            self.restart(slot, self.choose(slot))
            side = self.begin(slot, measure=self.measures)
            self.run(side)
            self.finish(side)
            rows = np.arange(self._searched)
            self._search(slot, rows, self._held["template_start"][:, rows])
            some = self._held["template_start"][:, : self._renewed]
            self.prepared(some, np.broadcast_to(np.eye(2), (*some.shape, 2)))

    def choose(self, slot: Slot) -> Array:
        """Points (1, N, 2) px worth tracking in a frame, NaN beyond those that were found."""
        given = {"topography_view": slot.views["topography_view"], "mask": self._mask}
        return self._run("detect", given)["points"]

    def restart(self, slot: Slot, points: Array) -> None:
        """Follows these points of a frame from now on and makes it the key frame; all states become unknown."""
        self.found = count_known(points)
        for value in self._states[self._finished % 2].values():
            state = value.numpy()
            value.update_inplace(np.full(state.shape, np.nan if state.dtype.kind == "f" else 0, state.dtype))
        for name, value in self._choice.items():
            value.update_inplace(np.ascontiguousarray(points, value.numpy().dtype))
            # Providers with memory of their own copy an input when it is bound, not when they run.
            for binding in self._field_bindings:
                binding.bind_ortvalue_input(name, value)
        self._latest = self._latest.of_others(points, slot.number)
        self._motions = [self._latest for _ in self._motions]
        self.key(slot, points)

    def key(self, slot: Slot, points: Array) -> None:
        """Makes a frame the one with which the next ones are compared, from the points (1, N, 2) found in it."""
        self._hold(self._run("key", {"topography_view": slot.views["topography_view"], "points": points}))
        self._key_view[...] = slot.views["topography_view"]
        self._latest, *self._motions = (motion.without(points) for motion in (self._latest, *self._motions))
        self.keyed = count_known(points)

    def stale(self, outputs: Mapping[str, Array], besides: Array) -> Renewal | None:
        """The templates that a frame has found to be deformed by more than they know, besides rows that are known."""
        rows = np.setdiff1d(np.flatnonzero(outputs["stale"][0]), besides)
        start = self._held["template_start"][:, rows]
        return Renewal(rows, start, outputs["warp"][:, rows], self._renewed) if len(rows) else None

    def prepared(self, points: Array, warp: Array) -> dict[str, Array]:
        """Templates of some points (1, n, 2) of the key frame for their deformation (1, n, 2, 2), in any thread."""
        missing = self._renewed - points.shape[1]
        given = {
            name: np.pad(array, ((0, 0), (0, missing)) + ((0, 0),) * (array.ndim - 2), mode="edge")
            for name, array in (("points", points), ("warp", warp))
        }
        results = self._run("renew", given)
        return {name: array[:, : points.shape[1]] for name, array in results.items()}

    def renew(self, rows: Array, templates: Mapping[str, Array]) -> None:
        """Uses these templates from now on; no frame may be under way."""
        for name, array in templates.items():
            self._held[name][:, rows] = array
            self._push(name)

    def use(self, threshold: float) -> None:
        """Makes this the relative intensity loss above which a pixel touches."""
        self.threshold = threshold
        empty = {"background": self.glass[None, None], "dark": self.dark[None, None]}
        self._hold(self._run("background", {**empty, "threshold": np.array([threshold])}))

    def begin(self, slot: Slot, measure: bool = False) -> int:
        """Makes ready to compute a frame, and to measure the threshold in it.

        Gives the side that `run` and `finish` are to be called with.
        """
        side = self._begun % len(self._bindings)
        motion = self._motions[(self._begun - self.lag) % len(self._motions)]
        self._begun += 1
        self._jolted[side] = None
        self._numbers[side], self._slots[side] = slot.number, slot if measure else None
        self._expected[side].update_inplace(np.ascontiguousarray(motion.expect(slot.number), self._place_type))
        for name, value in (slot.values | {"prediction": self._expected[side]}).items():
            self._bindings[side].bind_ortvalue_input(name, value)
        return side

    def run(self, side: int) -> None:
        """Computes a frame that has begun, in any thread."""
        self._engine.frame.run_with_iobinding(self._bindings[side])
        slot = self._slots[side]
        if slot is not None:
            view = slot.views["contact_view"]
            found = float(self._run(MEASURING, {"contact_view": view})["threshold"][0])
            # An empty glass has a threshold too, of noise or below none; and valleys of the skin do not touch.
            physical = 0 < found < 1 and touching(view[0, 0], self.glass, self.dark, found) < _EVERYTHING
            self._measured[side] = found if physical else math.nan

    def look_again(self, slot: Slot, side: int) -> SecondLook:
        """A frame that has run, once more where many points are lost at once."""

        def run(nearer: Array) -> Mapping[str, Array]:
            self._expected[side].update_inplace(np.ascontiguousarray(nearer, self._place_type))
            # Providers with memory of their own copy an input when it is bound, not when they run.
            self._bindings[side].bind_ortvalue_input("prediction", self._expected[side])
            self._engine.frame.run_with_iobinding(self._bindings[side])
            return self._results[side]

        look = SecondLook(self._latest, slot.number, self._expected[side].numpy(), self._results[side])
        look.take(run, partial(self._search, slot), self._searched)
        self._jolted[side] = look.jolted
        return look

    def _search(self, slot: Slot, rows: Array, near: Array) -> Array:
        """Where points (n,) of the key frame lie around where they are expected (1, n, 2)."""
        given = {"points": self._held["template_start"][:, rows], "prediction": near}
        views = {"key_view": self._key_view, "topography_view": slot.views["topography_view"]}
        return self._run("search", given | views)["found"]

    def found_in(self, side: int) -> int:
        """Points found in a frame that has run."""
        return count_known(self._results[side]["points"])

    def skip(self, side: int) -> None:
        """In place of `finish`, of a frame that does not count: motion and states are as before it. One that counts
        after all, as the next one shows, is then finished `late`.
        """
        self._motions[side] = self._latest

    def finish(self, side: int, late: bool = False) -> dict[str, Array]:
        """Outputs by name, (1, ...), of a frame that has run; valid until the next one is finished.

        From a frame that is finished late no other takes where points are expected before the next one has ended: it
        may have begun.
        """
        results, number = self._results[side], self._numbers[side]
        self._latest = self._latest.see(results["points"], number, results["by_neighbours"], self._jolted[side])
        if not late:
            self._motions[side] = self._latest
        binding = self._field_bindings[self._finished % 2]
        for name in self._of_frame:
            binding.bind_ortvalue_input(name, self._values[side][name])
        self._sessions["fields"].run_with_iobinding(binding)
        self._finished += 1
        return results | self._fields

    def measured(self, side: int) -> float | None:
        """The threshold found in a frame, NaN where it shows no contact; None where it was not asked for."""
        return None if self._slots[side] is None else self._measured[side]

    def _tensors(self, graph: str, side: str) -> dict[str, Tensor]:
        arguments = getattr(self._sessions[graph], side)()
        return {argument.name: Tensor.of(argument, self._bundle.files[graph]) for argument in arguments}

    def _room(self, tensor: Tensor) -> Any:
        return ort.OrtValue.ortvalue_from_shape_and_type(tensor.shape, tensor.dtype, self._engine.device)

    def _value(self, array: Array) -> Any:
        """The same memory where the provider computes in it, else a copy."""
        if self._engine.device == "cpu":
            return ort.OrtValue.ortvalue_from_numpy(array)
        return ort.OrtValue.ortvalue_from_numpy(array, self._engine.device)

    def _push(self, name: str) -> None:
        """Gives `frame` what is held now."""
        if self._engine.device != "cpu":
            self._held_values[name].update_inplace(self._held[name])
        if name in self._frame_inputs:
            # Providers with memory of their own copy an input when it is bound, not when they run.
            for each in self._bindings:
                each.bind_ortvalue_input(name, self._held_values[name])

    def _open_measuring(self) -> ort.InferenceSession:
        if MEASURING not in self._bundle.files:
            raise PlayerError(
                f"{self._bundle.files['background']}: takes a threshold, the scene has no number for it and the bundle "
                "no contact.onnx that would measure it; add [contact] threshold = with the relative intensity loss "
                'that counts as contact, such as 0.25, or export the bundle with the graph "contact"'
            )
        return self._engine.open(MEASURING)

    def _constants(self, graph: str, inputs: Mapping[str, Tensor], known: set[str]) -> dict[str, Any]:
        """Inputs that the scene gives; raises PlayerError for an input that nothing gives."""
        path, given = self._bundle.files[graph], self._of_scene
        constants = {}
        for name, tensor in inputs.items():
            if name in given and name not in known:
                value = np.ascontiguousarray(given[name], tensor.dtype).reshape(tensor.shape)
                constants[name] = ort.OrtValue.ortvalue_from_numpy(value, self._engine.device)
            elif name in ("contact_view", "topography_view"):
                expected = (1, 1, self._bundle.height, self._bundle.width), self._bundle.dtype
                if (tensor.shape, tensor.dtype) != expected:
                    raise PlayerError(
                        f"{path}: {name} is {tensor.dtype} {tensor.shape}, bundle.json says {expected[1]} "
                        f"{expected[0]}: a foreign model file; export the bundle again"
                    )
            elif name not in known:
                raise PlayerError(
                    f"{path}: needs an input {name!r} that this player does not know; use the player of its bundle"
                )
        return constants

    def _binding(self, side: int, constants: Mapping[str, Any]) -> Any:
        binding = self._engine.frame.io_binding()
        for name, value in constants.items():
            binding.bind_ortvalue_input(name, value)
        for name, value in self._values[side].items():
            binding.bind_ortvalue_output(name, value)
        return binding

    def _field_binding(self, side: int, constants: Mapping[str, Any]) -> Any:
        binding = self._sessions["fields"].io_binding()
        for name, value in {**constants, **self._choice, **self._states[side]}.items():
            binding.bind_ortvalue_input(name, value)
        for name, value in self._states[1 - side].items():
            binding.bind_ortvalue_output(f"next_{name}", value)
        for name, array in self._fields.items():
            binding.bind_ortvalue_output(name, ort.OrtValue.ortvalue_from_numpy(array))
        return binding

    def _run(self, graph: str, given: Mapping[str, Array]) -> dict[str, Array]:
        """One of the graphs that run rarely."""
        session, path = self._sessions[graph], self._bundle.files[graph]
        inputs = self._tensors(graph, "get_inputs")
        known = {**self._held, **given}
        if unknown := sorted(set(inputs) - set(known)):
            raise PlayerError(f"{path}: needs inputs {unknown} that this player does not give; use its bundle's")
        feed = {
            name: np.ascontiguousarray(known[name], tensor.dtype).reshape(tensor.shape)
            for name, tensor in inputs.items()
        }
        names = [argument.name for argument in session.get_outputs()]
        return dict(zip(names, session.run(names, feed), strict=True))

    def _hold(self, found: Mapping[str, Array]) -> None:
        """Keeps what the graphs to come take."""
        for name, array in found.items():
            self._held[name][...] = array
            self._push(name)


def _region_mask(scene: Scene, shape: tuple[int, ...]) -> Array:
    mask = np.zeros(shape, np.bool_)
    if scene.drawn is not None:
        for row, first, end in region_runs(scene.drawn, shape[-2], shape[-1]):
            mask[0, 0, row, first:end] = True
        return mask
    region = scene.region or View((0, shape[-2]), (0, shape[-1]))
    region.crop(mask[0, 0])[...] = True
    return mask
