"""Inputs of a run, opened and checked: recording, background, calibration, regions of interest, reference frame of the
displacement, and compute engine.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from fingerflow.engines.choice import ENGINES, engine_for
from fingerflow.engines.engine import Engine, EngineSettings
from fingerflow.engines.torch import images_on
from fingerflow.errors import FingerflowError
from fingerflow.kernels.array_types import Array, Mask, Numbers, Picture, Series
from fingerflow.recordings import Recording, open_recording
from fingerflow.recordings.drawn_region import drawn_mask
from fingerflow.recordings.lens import Geometry
from fingerflow.schema.key_types import parse_seconds
from fingerflow.schema.keys import keys_of
from fingerflow.schema.scene import Scene, check_scale
from fingerflow.schema.variables import FRAME_STATUS, USABLE
from fingerflow.schema.views import View, negative
from fingerflow.tracker.points import RECORDING, Knowledge

# Largest number of background frames averaged: the noise of 64 is an eighth of that of one frame. Most frames of the
# recording in which the largest count is searched, too.
_REFERENCE_FRAMES = 64
_LEAST_LIGHT = 0.05  # least share of the light of the empty glass that a picture without light lacks
# Size of decoded frames that stay in memory: frames are checked before they are tracked, and decoding may take as long
# as both.
_KEPT_BYTES = 512 * 2**20
#: Keys of the scale of the contact view.
SCALE_KEYS = ("calibration.mm_per_px", "calibration.intrinsics", "calibration.distortion")
_ONSET = (
    "each point's own onset, the frame in which the contact comes to cover it. Gradients are by the positions of onset "
    "(Willemet et al. 2021), and differ from the strain of skin that moves while the contact grows over it"
)


@dataclass
class Inputs:
    """Inputs of a run on one device: scene, opened recording, frame times and compute engine.

    Attributes:
        times: (frames,) s of the selected frames, from the trigger frame where the scene names one.
        engine: computes contact, points and fields.
        knowledge: what tracking may use of later frames.
    """

    scene: Scene
    recording: Recording
    times: Series
    device: torch.device
    warnings: list[str]
    engine: Engine
    knowledge: Knowledge = RECORDING
    # Mean background frames, read once for each file and view.
    _stills: dict[tuple[Any, View], Tensor] = field(default_factory=dict)

    def replace_scene(self, scene: Scene) -> "Inputs":
        """Return a copy of the inputs with the settings of another scene and engine "auto", but the same recording."""
        return replace(self, scene=scene, engine=engine_for("auto", _engine_settings(scene), self.device))

    @property
    def mm_per_px(self) -> float:
        return self.scene.calibration.mm_per_px

    @cached_property
    def geometry(self) -> Geometry:
        """Return the conversion between px of the views and mm on the glass."""
        scene = self.scene
        return Geometry(scene.calibration, scene.views.contact, scene.views.topography)

    def tensor(self, values: Picture) -> Tensor:
        """Return an array as a float32 tensor on the device of the run."""
        return torch.from_numpy(np.asarray(values, dtype=np.float32)).to(self.device)

    def counts(self, frames: Array, view: View) -> Array:
        """Crop frames (..., H, W) to a view; return the negative of the contact view if contact appears bright in it,
        so that contact is dark in every picture from which contact is measured.
        """
        return self._darken_contact(view.crop(frames), view)

    def _darken_contact(self, counts: Any, view: View) -> Any:
        return negative(counts, self._largest_count) if self._is_bright(view) else counts

    @cached_property
    def _largest_count(self) -> float:
        """Return the largest count that the camera can give. Integer pixels may have more bits than the camera: its
        bits are those that a sample of the frames fills. For floating-point frames it is the largest in the sample.
        """
        sample = read_frames(self.recording[:: -(-len(self.recording) // _REFERENCE_FRAMES)])
        largest: float = np.max(sample, initial=0, where=np.isfinite(sample)).item()
        return largest if isinstance(largest, float) else 2 ** max(8, largest.bit_length()) - 1

    def _is_bright(self, view: View) -> bool:
        return self.scene.contact.appears == "bright" and view == self.scene.views.contact

    def contact_view(self, frames: Array) -> Tensor:
        """Return the contact view of frames (n, H, W) as a read-only tensor (n, 1, h, w) on the device of the run, and
        its negative if contact appears bright.
        """
        return images_on(self.device, self.counts(frames, self.scene.views.contact))

    def reference(self, view: View) -> Tensor:
        """Return the background of a view, recorded without a finger, as (1, 1, h, w) float32; its negative as in
        `counts`.
        """
        return self._darken_contact(self._still(self.scene.background.frames, view), view)

    def dark(self, view: View) -> Tensor | None:
        """Return an image (1, 1, h, w) of the view recorded in darkness, as float32; None if none was recorded, or if
        contact appears bright: the dark level cancels in the difference of two negatives.

        Raises FingerflowError if it is as bright as the empty glass.
        """
        path, glass = self.scene.background.dark, self.scene.background.frames
        if path is None or self._is_bright(view):
            return None
        dark = self._still(path, view)
        light = self._still(glass, view).mean()
        if light - dark.mean() < _LEAST_LIGHT * light:
            raise FingerflowError(
                f"{path}: the dark background is as bright as the empty glass, {glass}; record it without light, or "
                "leave background.dark out"
            )
        return dark

    def glass(self, view: View) -> tuple[Array, Array | None]:
        """Return `reference` and `dark` as arrays (h, w)."""
        reference, dark = self.reference(view)[0, 0].cpu().numpy(), self.dark(view)
        return reference, None if dark is None else dark[0, 0].cpu().numpy()

    def _still(self, path: Any, view: View) -> Tensor:
        if (path, view) in self._stills:
            return self._stills[path, view]
        remedy = "record it with the same camera settings"
        with open_recording(path) as still:
            if still.frame_shape != self.recording.frame_shape:
                raise FingerflowError(
                    f"{path}: the background has frames of {_size(still.frame_shape)}, the recording "
                    f"{self.recording.path} of {_size(self.recording.frame_shape)}; {remedy}"
                )
            if {still.dtype.itemsize, self.recording.dtype.itemsize} == {1, 2}:
                raise FingerflowError(
                    f"{path}: the background has {still.bit_depth} bit, the recording {self.recording.path} "
                    f"{self.recording.bit_depth}: their grey levels cannot be compared; {remedy}"
                )
            if not len(still):
                raise FingerflowError(f"{path}: the background has no frame; {remedy}")
            # The same pixels in any format; a single frame of the recording may show the empty glass.
            frames, last = self.recording, self.scene.recording.first_frame + len(self.recording) - 1
            if last < len(still) and all(np.array_equal(still[last - k], frames[~k]) for k in {0, len(frames) - 1}):
                raise FingerflowError(f"{path}: the background is the recording itself; name one of the empty glass")
            part = still[:_REFERENCE_FRAMES]
            pictures = view.crop(read_frames(part))
            whole = [index for index in range(len(part)) if index not in part.unreadable]
            if not whole:
                raise FingerflowError(f"{path}: frame 0 of the background {part.unreadable[0]}; {remedy}")
            mean = pictures[whole].mean(axis=0, dtype=np.float64)
        self._stills[path, view] = torch.from_numpy(mean.astype(np.float32))[None, None].to(self.device)
        return self._stills[path, view]


def read_frames(part: Recording) -> Array:
    """Return the frames (n, H, W) of a recording. Raises FingerflowError where the system cannot read them."""
    try:
        return part.mapped()
    except OSError as error:  # reported here: `written_atomically` would report it as an error of the output file
        raise FingerflowError(
            f"{part.path}: frames cannot be read ({error.strerror or error}); copy the recording to a local disk"
        ) from error


def open_inputs(scene: Scene, device: str, engine: str = "auto") -> Inputs:
    """Open the recording of a scene, and check that all views of the scene lie within the frames.

    `engine` is one of `engines.choice.ENGINES`.

    Raises FingerflowError for what does not fit; the message gives the value and the remedy.
    """
    if engine not in ENGINES:
        raise FingerflowError(f"the engine {engine!r} is not known; choose {', '.join(ENGINES[:-1])} or {ENGINES[-1]}")
    if engine == "onnx" and device not in ("auto", "cpu"):
        raise FingerflowError(f"the engine onnx computes on the processor, not on {device!r}; choose auto or cpu")
    chosen = _device("cpu" if engine == "onnx" else device)
    settings = scene.recording
    recording = open_recording(settings.frames, frame_rate=settings.frame_rate)
    recording.file.kept_bytes = _KEPT_BYTES
    if not len(recording):
        raise FingerflowError(f"{settings.frames} has no frame; copy it again, or name another recording")
    for name in ("first_frame", "trigger_frame"):
        if (number := getattr(settings, name)) is not None and number >= len(recording):
            raise FingerflowError(
                f"{scene.path}: recording.{name} is {number}, but {settings.frames} has {len(recording)} frames, 0 to "
                f"{len(recording) - 1}"
            )
    warnings = [*recording.warnings, *check_scale(scene)]
    if settings.last_frame is not None and settings.last_frame >= len(recording):
        warnings.append(
            f"recording.last_frame is {settings.last_frame}, but {settings.frames} ends with frame {len(recording) - 1}"
            ": leave it out, or copy the recording again"
        )
    end = len(recording) if settings.last_frame is None else min(settings.last_frame + 1, len(recording))
    if recording.times is None:
        raise FingerflowError(
            f"{settings.frames} states no frame rate; give it in the scene, [recording] frame_rate = 300.0 (Hz)"
        )
    times = np.asarray(recording.times, dtype=np.float64)
    if settings.trigger_frame is not None:
        times = times - times[settings.trigger_frame]
    times = times[settings.first_frame : end]
    requested_frame(scene, times)  # raises for a wrong reference before anything is computed
    selected = recording[settings.first_frame : end]
    for name, view in (("contact", scene.views.contact), ("topography", scene.views.topography)):
        if view is not None:
            try:
                view.crop(np.empty(selected.frame_shape, dtype=np.uint8))
                Geometry(scene.calibration, view, None)
            except FingerflowError as error:
                raise FingerflowError(f"{scene.path}: views.{name} and {settings.frames}: {error}") from None
    if len(selected) == 1:
        warnings.append("one frame: nothing has moved since, displacement, divergence and strain are 0 by definition")
    return Inputs(scene, selected, times, chosen, warnings, _engine(engine, scene, chosen))


def requested_frame(scene: Scene, times: Series) -> int | None:
    """Return the frame that the setting `fields.reference` gives as a number or time; None for a word such as "onset".

    Frames count from 0 at the first selected frame; `times` (frames,) s. Raises FingerflowError for a frame outside the
    selection.
    """
    setting, first = scene.fields.reference, scene.recording.first_frame
    seconds = parse_seconds(setting)
    if seconds is not None:
        half_step = float(np.median(np.diff(times))) / 2 if len(times) > 1 else 0.0
        within = times[0] - half_step <= seconds <= times[-1] + half_step
        frame = int(np.argmin(np.abs(times - seconds)))
    elif isinstance(setting, int):
        frame = setting - first
        within = 0 <= frame < len(times)
    else:
        return None
    if not within:
        raise FingerflowError(
            f"{scene.path}: fields.reference is {setting!r}, and the frames that count are {first} to "
            f"{first + len(times) - 1}, from {times[0]:g} to {times[-1]:g} s after the trigger; give one of them"
        )
    return frame


def resolve_reference(
    scene: Scene, times: Series, status: Numbers, warnings: list[str]
) -> tuple[int | None, dict[str, str | int]]:
    """Return the frame from which displacement counts, from 0 at the first selected frame, or None for each point's own
    onset; and the attributes that say so of a result variable, with the number of the frame in the file.

    `times` (s) and `status` are those of all frames. Raises FingerflowError for a frame outside the selection or an
    unusable one.
    """
    setting, first = scene.fields.reference, scene.recording.first_frame
    if setting in ("onset", "dilated_onset"):
        rim = f"; the contact has a rim of {scene.contact.gross_radius_px} px here" if setting != "onset" else ""
        return None, {"reference": _ONSET + rim}
    usable = np.flatnonzero(status == USABLE)
    frame = requested_frame(scene, times)
    if frame is None:
        frame = int(usable[0])
        if frame:
            warnings.append(
                f"fields.reference is {setting!r}: frame {first} is {FRAME_STATUS[status[0]]}, so displacement counts "
                f"from frame {frame + first}, the first that can be measured"
            )
    if frame not in usable:
        near = int(usable[np.argmin(np.abs(usable - frame))]) + first
        raise FingerflowError(
            f"{scene.path}: fields.reference is {setting!r}, which is frame {frame + first}: it is "
            f"{FRAME_STATUS[status[frame]]}, so no point is known there; take frame {near}"
        )
    definition = f"frame {frame + first}, {times[frame]:.4g} s from the trigger, for all points that are known there"
    return frame, {"reference": f"{definition}; values are of skin in contact", "reference_frame": frame + first}


def region_mask(scene: Scene, name: str) -> Mask | None:
    """Return the mask (h, w) of the region of interest of a view; None if the scene defines none.

    Raises FingerflowError for a region without a pixel of the view, and for a mask image that cannot be read or has
    another size.
    """
    view = scene.views[name]
    if view.region is None:
        return None
    key = f"{scene.path}: views.{name}.region"
    mask = drawn_mask(view.region, view.shape)
    if (path := view.region.mask) is not None:
        picture = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_GRAYSCALE) if path.stat().st_size else None
        if picture is None:
            raise FingerflowError(f"{key}: {path} is no picture that can be read; save it as PNG")
        if picture.shape != view.shape:
            raise FingerflowError(
                f"{key}: {path} has {picture.shape[0]} x {picture.shape[1]} px, the view {view.shape[0]} x "
                f"{view.shape[1]}; draw it on the view, pixel by pixel"
            )
        mask = picture > 0
    if not mask.any():
        raise FingerflowError(
            f"{key} holds no pixel of the view of {view.shape[0]} x {view.shape[1]} px, counted from its own corner"
        )
    return mask


def _engine(name: str, scene: Scene, device: torch.device) -> Engine:
    if name != "onnx":
        return engine_for(name, _engine_settings(scene), device)
    # Imported here, as the import is slow and needed for this engine only.
    from fingerflow.export.recording_engine import recording_engine

    return recording_engine(_engine_settings(scene), torch.get_num_threads())


def _engine_settings(scene: Scene) -> EngineSettings:
    stated = {**vars(scene.contact), **vars(scene.tracking), **vars(scene.fields)}
    shared = keys_of(EngineSettings).keys() & stated.keys()
    return EngineSettings(strain=scene.fields.strain, **{name: stated[name] for name in shared})


def _device(name: str) -> torch.device:
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).partition("\n")[0]
        raise FingerflowError(f"the device {name!r} cannot be used ({reason}); choose auto, cpu or cuda") from error
    return device


def _size(shape: tuple[int, int]) -> str:
    return f"{shape[0]} rows x {shape[1]} columns"
