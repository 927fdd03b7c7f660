"""Runs an exported bundle on a live stream: numpy and onnxruntime, no torch; copied into the bundle as it is.

    python player.py --source synthetic             # in the bundle's folder
    fingerflow stream BUNDLE --source frames.npy --scene scene.toml    # the same from the package

Threads pass frames on: capture, one for each frame that is computed side by side, sink; the main thread watches them
and another serves the live page.
Every array that the graphs read or write is made once. Positions are (x, y) px of the views with integer pixel centres,
areas mm², axes mm, times s.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import hashlib
import importlib
import importlib.util
import json
import logging
import math
import os
import signal
import struct
import sys
import threading
import time
import tomllib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from datetime import UTC, datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, BinaryIO, Generic, NamedTuple, Protocol, TextIO, TypeVar

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

BUNDLE_FORMAT = 1
RESULTS_FORMAT = 1
Array = NDArray[Any]
T = TypeVar("T")
log = logging.getLogger("fingerflow.player")


class PlayerError(Exception):
    """What the user can put right: names the file or setting, the value found and the way out."""


# --- scene ------------------------------------------------------------------------------------------------------------

# The keys of a scene file, as `fingerflow process` has them; the player reads a part, one file serves both.
SCENE_KEYS = {
    "recording": ("first_frame", "frame_rate", "frames", "last_frame", "trigger_frame"),
    "views": ("contact", "topography"),
    "background": ("dark", "frames"),
    "forces": ("file", "normal", "sample_rate", "tangential", "time", "trigger", "trigger_level"),
    "calibration": ("file", "mm_per_px", "topography_to_contact"),
    "contact": ("gross_radius_px", "median_px", "threshold"),
    "tracking": (
        *("direction", "forward_backward_limit_px", "gain_offset", "min_distance_px"),
        *("points", "search_px", "template", "window_px"),
    ),
    "fields": ("depth_mm", "gauge_length_mm", "poisson_ratio", "rate_window_s", "strain", "young_modulus_mpa"),
    "stream": ("output", "region", "rekey_frames", "rekey_share"),
    "slip": ("stuck_mm",),
}


class View(NamedTuple):
    """A rectangle of pixels, half-open ranges."""

    rows: tuple[int, int]
    columns: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int]:
        return self.rows[1] - self.rows[0], self.columns[1] - self.columns[0]

    def crop(self, frame: Array) -> Array:
        return frame[self.rows[0] : self.rows[1], self.columns[0] : self.columns[1]]


@dataclass(frozen=True)
class Scene:
    """Where the views lie in a frame, their scale, and what empty glass looks like.

    Frames count from `first_frame` to `last_frame` of the recording. ``region`` is the part of the topography view in
    which points are chosen, None for all of it. ``asked`` has the settings that a recipe has decided already, by table
    and key.
    """

    contact: View
    topography: View
    mm_per_px: float
    topography_to_contact: Array
    threshold: float | None = None
    background: Path | None = None
    dark: Path | None = None
    frames: Path | None = None
    frame_rate: float | None = None
    first_frame: int = 0
    last_frame: int | None = None
    output: Path | None = None
    region: View | None = None
    rekey_share: float | None = None
    rekey_frames: int | None = None
    asked: Mapping[str, Any] = field(default_factory=dict)


def side_by_side(height: int, width: int) -> Scene:
    """The scene of the synthetic source: topography on the left, contact on the right, one scale."""
    return Scene(
        contact=View((0, height), (width, 2 * width)),
        topography=View((0, height), (0, width)),
        mm_per_px=0.025,
        topography_to_contact=np.array([[1.0, 0, 0], [0, 1, 0]]),
        threshold=0.35,
    )


def load_scene(path: Path) -> Scene:
    """Reads what a stream needs of a scene file; raises PlayerError with file, key, value and remedy."""
    return _SceneFile(path).scene()


class _SceneFile:
    """One TOML file; every complaint names it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.values = self._read(path)
        self._refuse_unknown(self.values, tuple(SCENE_KEYS), "")
        for table, keys in SCENE_KEYS.items():
            self._refuse_unknown(self.values.get(table, {}), keys, f"{table}.")

    def scene(self) -> Scene:
        first, last = self._count("recording.first_frame", 0) or 0, self._count("recording.last_frame", 0)
        if last is not None and last < first:
            raise self._wrong(
                "recording.last_frame", last, f"both are included: first_frame, {first}, or more is needed"
            )
        scale, transform = self._calibration()
        return Scene(
            contact=self._view("views.contact"),
            topography=self._view("views.topography"),
            mm_per_px=scale,
            topography_to_contact=transform,
            threshold=self._threshold(),
            background=self._file("background.frames"),
            dark=self._file("background.dark"),
            frames=self._file("recording.frames"),
            frame_rate=self._number("recording.frame_rate", 0.0, 1e6),
            first_frame=first,
            last_frame=last,
            output=self._file("stream.output"),
            region=None if self._get("stream.region") is None else self._view("stream.region"),
            rekey_share=self._number("stream.rekey_share", 0.0, 1.0),
            rekey_frames=self._count("stream.rekey_frames"),
            asked={
                f"{table}.{key}": value
                for table in ("contact", "tracking", "fields")
                for key, value in self.values.get(table, {}).items()
            },
        )

    def _threshold(self) -> float | None:
        """None where it is to be measured, whether from the reference frame or from each."""
        value = self._get("contact.threshold")
        if value in (None, "reference_frame", "per_frame"):
            return None
        return self._number("contact.threshold", 0.0, 1.0)

    def _calibration(self) -> tuple[float, Array]:
        """mm_per_px and the affine (2, 3) of the scene, or of the calibration file that it names."""
        place, transform_key = self, "calibration.topography_to_contact"
        scale_key = "calibration.mm_per_px"
        if (path := self._file("calibration.file")) is not None:
            place = _SceneFile.__new__(_SceneFile)
            place.path, place.values = path, self._read(path)
            scale_key, transform_key = "mm_per_px", "topography_to_contact.affine.matrix"
        scale, rows = place._number(scale_key, 0.0, 1.0), place._get(transform_key)
        if scale is None:
            raise place._wrong(scale_key, None, "mm per px of the contact view is needed")
        try:
            matrix = np.array(rows, dtype=np.float64)
        except (TypeError, ValueError):
            matrix = np.empty(0)
        if matrix.shape != (2, 3) or abs(np.linalg.det(matrix[:, :2])) < 1e-6:
            raise place._wrong(transform_key, rows, "an invertible [[a, b, x], [c, d, y]] is needed")
        return scale, matrix

    def _read(self, path: Path) -> dict[str, Any]:
        try:
            return tomllib.loads(path.read_text(encoding="utf-8-sig"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise PlayerError(
                f"{path}: cannot be read as TOML ({error}); scene.toml of a bundle is an example"
            ) from None

    def _refuse_unknown(self, table: Any, known: tuple[str, ...], prefix: str) -> None:
        if not isinstance(table, dict):
            raise self._wrong(prefix[:-1], table, "it must be a table")
        for key in table:
            if key not in known:
                close = difflib.get_close_matches(key, known, n=1)
                hint = f"did you mean {close[0]!r}? " if close else ""
                raise PlayerError(f"{self.path}: {prefix}{key} is not a key; {hint}known here: {', '.join(known)}")

    def _get(self, name: str) -> Any:
        found: Any = self.values
        for key in name.split("."):
            found = found.get(key) if isinstance(found, dict) else None
        return found

    def _wrong(self, name: str, value: Any, needed: str) -> PlayerError:
        return PlayerError(f"{self.path}: {name} {'is missing' if value is None else f'is {value!r}'}; {needed}")

    def _number(self, name: str, above: float, most: float) -> float | None:
        value = self._get(name)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not above < value <= most:
            raise self._wrong(name, value, f"a number above {above:g} and up to {most:g} is needed")
        return float(value)

    def _count(self, name: str, least: int = 1) -> int | None:
        value = self._number(name, least - 1, 1e9)
        if value is not None and value != int(value):
            raise self._wrong(name, value, "a whole number is needed")
        return None if value is None else int(value)

    def _file(self, name: str) -> Path | None:
        value = self._get(name)
        if value is not None and not isinstance(value, str):
            raise self._wrong(name, value, "a path, relative to the scene file, is needed")
        return None if value is None else (self.path.parent / value).resolve()

    def _view(self, name: str) -> View:
        ranges = []
        for key in ("rows", "columns"):
            value = self._get(f"{name}.{key}")
            whole = isinstance(value, list) and len(value) == 2 and all(type(end) is int for end in value)
            if not whole or not 0 <= value[0] < value[1]:
                raise self._wrong(f"{name}.{key}", value, "[first, end] px with 0 <= first < end is needed")
            ranges.append((value[0], value[1]))
        return View(*ranges)


# --- bundle and execution provider ------------------------------------------------------------------------------------

_COMPILED = "compiled"  # none of onnxruntime's: the package fingerflow, where it is installed, and only where asked for
PROVIDERS = {
    "tensorrt": "TensorrtExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "directml": "DmlExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "cpu": "CPUExecutionProvider",
    _COMPILED: "compiled kernels of fingerflow",
}
_PLUGINS = {"openvino": "onnxruntime_ep_openvino"}  # providers that come as a package beside onnxruntime
_ON_GPU = ("tensorrt", "cuda")  # those whose memory can be bound, so that states and held tensors stay there
GRAPHS = ("frame", "fields", "detect", "key", "renew", "background")  # without which nothing can be played
_MEASURING = "contact"  # the graph that finds the threshold where the scene gives none


@dataclass(frozen=True)
class Bundle:
    """An exported folder whose files are those that the export wrote."""

    folder: Path
    recipe: Mapping[str, Any]
    version: str
    hashes: Mapping[str, str]
    files: Mapping[str, Path]

    @property
    def height(self) -> int:
        return int(self.recipe["views"]["height"])

    @property
    def width(self) -> int:
        return int(self.recipe["views"]["width"])

    @property
    def bit_depth(self) -> int:
        return int(self.recipe["views"]["bit_depth"])

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of a pixel."""
        return np.dtype(np.uint8 if self.bit_depth == 8 else np.uint16)


def load_bundle(folder: Path) -> Bundle:
    """Reads bundle.json and checks every graph's file against its hash; raises PlayerError."""
    path = folder / "bundle.json"
    again = "export the bundle again, or copy its folder again"
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise PlayerError(
            f"{path}: cannot be read ({error.strerror}); name the folder that `fingerflow export` wrote"
        ) from None
    except ValueError as error:
        raise PlayerError(f"{path}: is no JSON ({error}); {again}") from None
    if not isinstance(facts, dict) or facts.get("format") != BUNDLE_FORMAT:
        found = facts.get("format") if isinstance(facts, dict) else facts
        raise PlayerError(
            f"{path}: its format is {found!r}, this player reads {BUNDLE_FORMAT}; use the player.py of the same bundle"
        )
    try:
        graphs = facts["graphs"]
        names = (*GRAPHS, _MEASURING) if _MEASURING in graphs else GRAPHS
        bundle = Bundle(
            folder=folder,
            recipe=facts["recipe"],
            version=str(facts["fingerflow"]),
            hashes={name: graphs[name]["sha256"] for name in names},
            files={name: folder / graphs[name]["file"] for name in names},
        )
        _ = bundle.height, bundle.width, bundle.dtype
    except (KeyError, TypeError, ValueError) as error:
        raise PlayerError(
            f"{path}: has no proper entry {error}; a stream needs the graphs {', '.join(GRAPHS)}: {again}"
        ) from None
    for name, file in bundle.files.items():
        try:
            digest = hashlib.sha256(file.read_bytes()).hexdigest()
        except OSError as error:
            raise PlayerError(f"{file}: cannot be read ({error.strerror}); {again}") from None
        if digest != bundle.hashes[name]:
            raise PlayerError(
                f"{file}: its SHA-256 is {digest[:16]}..., bundle.json has {bundle.hashes[name][:16]}...: the file is "
                f"damaged or belongs to another bundle; {again}"
            )
    return bundle


class Engine:
    """Opens the graphs of a bundle with one execution provider, the first that works or the one that was asked for.

    Args:
        provider: a key of PROVIDERS, or None for the first in their order.
        threads: inside an operator, 0 for one a core.
        spin: threads of `frame` wait for work without sleeping. Latency falls and the cores are never idle.
    """

    def __init__(self, bundle: Bundle, provider: str | None = None, threads: int = 0, spin: bool = True) -> None:
        self.bundle = bundle
        self.threads = threads
        self.spin = spin
        self._compiled = _compiled_graphs(bundle, threads) if provider == _COMPILED else None
        installed = _installed_providers()
        if provider is not None and provider not in (*installed, _COMPILED):
            raise PlayerError(f"provider {provider!r} is not installed here; there are: {', '.join(installed)}")
        for self.provider in [provider] if provider else installed:
            try:
                self.frame = self.open("frame")
                break
            except _ProviderFailed as failure:
                if provider or self.provider == "cpu":
                    raise PlayerError(f"provider {self.provider!r}: {failure}; choose another") from None
                log.warning("provider %s is installed but does not run here (%s)", self.provider, failure)
        self.device = "cuda" if self.provider in _ON_GPU else "cpu"
        log.info("execution provider: %s (onnxruntime %s)", PROVIDERS[self.provider], ort.__version__)

    def open(self, name: str) -> ort.InferenceSession:
        """A graph of the bundle; raises PlayerError where the file is not what the bundle says."""
        path = self.bundle.files[name]
        session = self._session(name, path) if self._compiled is None else self._compiled.open(name, path)
        properties = session.get_modelmeta().custom_metadata_map
        if properties.get("fingerflow.graph") != name:
            found = properties.get("fingerflow.graph", "no fingerflow metadata")
            raise PlayerError(f"{path}: holds {found!r} where the graph {name!r} is expected: a foreign model file")
        return session

    def _session(self, name: str, path: Path) -> ort.InferenceSession:
        options = ort.SessionOptions()
        options.intra_op_num_threads = self.threads
        options.log_severity_level = 3
        # The graphs that run rarely must not spin beside `frame`.
        spin = self.spin and name == "frame"
        options.add_session_config_entry("session.intra_op.allow_spinning", str(int(spin)))
        chosen: list[Any] = [PROVIDERS[self.provider], PROVIDERS["cpu"]]
        if self.provider == "tensorrt":
            engines = {"trt_engine_cache_enable": True, "trt_engine_cache_path": str(self.bundle.folder / "tensorrt")}
            chosen[0] = (PROVIDERS["tensorrt"], engines)
        devices = _plugin_devices(self.provider)
        if devices:
            options.add_provider_for_devices(devices[:1], {})
        try:
            session = ort.InferenceSession(path, options, providers=None if devices else list(dict.fromkeys(chosen)))
        except Exception as error:
            if self.provider != "cpu":
                raise _ProviderFailed(_first_line(error)) from None
            raise PlayerError(f"{path}: onnxruntime cannot load it ({_first_line(error)}); export it again") from None
        if PROVIDERS[self.provider] not in session.get_providers():
            raise _ProviderFailed("onnxruntime fell back to another one; its libraries are missing")
        return session


class _ProviderFailed(Exception):
    """An execution provider cannot run a graph here."""


def _installed_providers() -> list[str]:
    """Keys of PROVIDERS, in their order."""
    available = ort.get_available_providers()
    if PROVIDERS["cuda"] in available:
        ort.preload_dlls()  # CUDA's libraries where they were installed as Python packages
    return [name for name, full in PROVIDERS.items() if full in available or _plugin_devices(name)]


def _compiled_graphs(bundle: Bundle, threads: int) -> Any:
    """The graphs of a bundle by the package that exported it, which the player does without otherwise."""
    try:
        from fingerflow.errors import FingerflowError
        from fingerflow.export.compiled import CompiledGraphs
    except ImportError as error:
        raise PlayerError(
            f"provider {_COMPILED!r}: is the package fingerflow-engine, which is not installed here ({error}); install "
            "it, or choose another"
        ) from None
    try:
        return CompiledGraphs(bundle.recipe, bundle.version, threads)
    except FingerflowError as error:
        raise PlayerError(f"provider {_COMPILED!r}: {error}; or choose another") from None


def _plugin_devices(provider: str) -> list[Any]:
    """Devices of an execution provider that is installed as a plugin package."""
    if provider not in _PLUGINS or importlib.util.find_spec(_PLUGINS[provider]) is None:
        return []
    full = PROVIDERS[provider]
    if not any(device.ep_name == full for device in ort.get_ep_devices()):
        ort.register_execution_provider_library(full, importlib.import_module(_PLUGINS[provider]).get_library_path())
    return [device for device in ort.get_ep_devices() if device.ep_name == full]


def _first_line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]


# --- sources ----------------------------------------------------------------------------------------------------------


class Source(Protocol):
    """Gives frames (H, W) one after another, None at the end. Anything it raises but PlayerError is tried again."""

    live: bool  # frames come whether or not there is room for them

    def read(self) -> Array | None: ...

    def close(self) -> None: ...


OpenSource = Callable[[int], Source]  # from the number of the next frame


class Recording:
    """Frames that can be read by number."""

    live = False

    def __init__(self, frames: Array, first: int) -> None:
        self._frames = frames
        self._next = first

    def read(self) -> Array | None:
        if self._next >= len(self._frames):
            return None
        self._next += 1
        return self._frames[self._next - 1]

    def close(self) -> None:
        """A map of a file goes with its last reader."""


class Video:
    """Frames of a video, made grey; only where OpenCV is installed."""

    live = False

    def __init__(self, path: Path, first: int) -> None:
        try:
            self._cv2 = importlib.import_module("cv2")
        except ImportError:
            raise PlayerError(
                f"{path}: videos need OpenCV: `pip install opencv-python-headless`, or give frames as .npy"
            ) from None
        self._capture = self._cv2.VideoCapture(str(path))
        if not self._capture.isOpened():
            raise PlayerError(f"{path}: OpenCV cannot open this video; give frames as .npy")
        for _ in range(first):
            self._capture.grab()

    def read(self) -> Array | None:
        there, frame = self._capture.read()
        if not there:
            return None
        grey: Array = self._cv2.cvtColor(frame, self._cv2.COLOR_BGR2GRAY) if frame.ndim == 3 else frame
        return grey

    def close(self) -> None:
        self._capture.release()


class Camera:
    """Any callable that gives the next frame; `close` is called where it has one."""

    live = True

    def __init__(self, grab: Callable[[], Array | None]) -> None:
        self._grab = grab

    def read(self) -> Array | None:
        return self._grab()

    def close(self) -> None:
        getattr(self._grab, "close", lambda: None)()


class Synthetic:
    """Frames of a pressed fingertip drawn from formulas: no end, and no cost once a ring of them is drawn.

    Ridges and pores move, turn and spread by up to 4 % in each direction and back, while the contact grows and shrinks.
    The divergence of a stream is another one, even negative: each point's counts from when the contact reaches it.
    Of one period only half is kept, played forwards and backwards.
    """

    live = False
    half_period = 60  # frames

    def __init__(self, scene: Scene, dtype: np.dtype[Any], bit_depth: int) -> None:
        self._next = 0
        views = (scene.topography, scene.contact)
        shape = tuple(max(ends) for ends in zip(*((view.rows[1], view.columns[1]) for view in views), strict=True))
        self._ring = np.zeros((self.half_period, *shape), dtype)
        gain = 2.0 ** (bit_depth - 8)
        for number, frame in enumerate(self._ring):
            progress = (1 - math.cos(math.pi * number / (self.half_period - 1))) / 2
            skin, _ = _draw_finger(scene.topography.shape, progress)
            scene.topography.crop(frame)[...] = (90 + 70 * skin) * gain
            _, lost = _draw_finger(scene.contact.shape, progress)
            scene.contact.crop(frame)[...] = 200 * (1 - 0.7 * lost) * gain
        self.background = np.full(shape, 200 * gain, dtype)

    def from_frame(self, number: int) -> Synthetic:
        self._next = number
        return self

    def read(self) -> Array:
        place = self._next % (2 * self.half_period - 2)
        self._next += 1
        return self._ring[min(place, 2 * self.half_period - 2 - place)]

    def close(self) -> None:
        """Nothing is open."""


def _draw_finger(shape: tuple[int, int], progress: float) -> tuple[Array, Array]:
    """Brightness of the skin, about -1 to 1, and share 0 to 1 of intensity lost to contact, both (H, W) float32."""
    height, width = shape
    turn, spread = 0.01 * progress, 1 + 0.04 * progress
    y, x = np.meshgrid(
        np.arange(height, dtype=np.float32) - height / 2,
        np.arange(width, dtype=np.float32) - width / 2,
        indexing="ij",
        sparse=True,
    )
    moved_x, moved_y = x - 4 * progress, y + 2 * progress
    # Where the skin that is seen at a pixel was at the start.
    u = (math.cos(turn) * moved_x + math.sin(turn) * moved_y) / spread
    v = (-math.sin(turn) * moved_x + math.cos(turn) * moved_y) / spread
    ridges = np.cos(2 * np.pi / 16 * (np.hypot(u, v + 60) + 6 * np.cos(u / 45)))
    pores = np.cos(0.31 * u + 0.17 * v) * np.cos(0.13 * u - 0.37 * v) + np.cos(0.21 * u - 0.11 * v + 1) / 2
    semi_x, semi_y = (0.18 + 0.14 * progress) * width, (0.18 + 0.18 * progress) * height
    inside = np.clip((1 - np.hypot(moved_x / semi_x, moved_y / semi_y)) * min(semi_x, semi_y), 0, 1)
    return 0.55 * ridges + 0.3 * pores, np.clip(0.5 + 4 * (ridges + 0.2), 0, 1) * inside


def open_recording(path: Path, shape: tuple[int, int] | None, dtype: str, first: int = 0) -> Source:
    """Frames of a .npy file (N, H, W) or (H, W), of a raw file of ``shape`` and ``dtype``, or of a video."""
    if not path.is_file():
        raise PlayerError(f"{path}: is no file; give a .npy, raw or video file, or `synthetic`")
    try:
        if path.suffix == ".npy":
            frames = np.load(path, mmap_mode="r")
        elif shape is not None:
            pixels = np.memmap(path, np.dtype(dtype), "r")
            frames = pixels[: len(pixels) - len(pixels) % math.prod(shape)].reshape(-1, *shape)
        elif path.suffix in (".raw", ".bin"):
            raise PlayerError(f"{path}: a raw file needs --shape HEIGHT WIDTH and --dtype of its frames")
        else:
            return Video(path, first)
    except (ValueError, TypeError) as error:
        raise PlayerError(f"{path}: cannot be read as frames ({error})") from None
    frames = frames[None] if frames.ndim == 2 else frames
    if frames.ndim != 3 or not len(frames):
        raise PlayerError(f"{path}: its array is {frames.shape}; frames are (N, H, W) and at least one is needed")
    return Recording(frames, first)


def open_camera(name: str) -> Source:
    """``module:factory`` called: it gives a callable that returns the next frame, or None at the end."""
    module, _, factory = name.partition(":")
    sys.path.insert(0, os.getcwd())
    try:
        make = getattr(importlib.import_module(module), factory)
    except (ImportError, AttributeError, ValueError) as error:
        raise PlayerError(f"camera {name!r}: {error}; give MODULE:FACTORY of a module in this folder") from None
    finally:
        sys.path.pop(0)
    grab = make()
    if not callable(grab):
        raise PlayerError(f"camera {name!r}: its factory gave {type(grab).__name__}; it must return a callable")
    return Camera(grab)


_STILLS = 64  # of a recording of the empty glass are averaged: its noise is then an eighth of a frame's


def mean_view(path: Path, view: View, bundle: Bundle, shape: tuple[int, int] | None, dtype: str) -> Array:
    """A view of the mean of the first frames of a file, (H, W) float32; the frames may be of the view alone.

    Raises PlayerError where the file has no frame, or frames of another size or depth than the camera's.
    """
    source = open_recording(path, shape, dtype)
    total, count = np.zeros(view.shape), 0
    try:
        while count < _STILLS and (frame := source.read()) is not None:
            if frame.dtype.kind != "f" and frame.dtype != bundle.dtype:
                raise PlayerError(
                    f"{path}: a frame is {frame.dtype}, the bundle takes {bundle.dtype} (bit_depth "
                    f"{bundle.bit_depth}): grey levels of two depths cannot be compared; record it with the settings "
                    "of the stream"
                )
            part = frame if frame.shape == view.shape else view.crop(frame)
            if part.shape != view.shape:
                raise PlayerError(
                    f"{path}: a frame is {frame.shape}, the view of the scene needs (H, W) of at least "
                    f"{(view.rows[1], view.columns[1])}; record it with the settings of the stream"
                )
            total, count = total + part, count + 1
    finally:
        source.close()
    if not count:
        raise PlayerError(f"{path}: has no frame; one of the empty glass is needed")
    mean: Array = (total / count).astype(np.float32)
    return mean


# --- hand-over between threads ----------------------------------------------------------------------------------------


class Channel(Generic[T]):
    """A bounded queue between threads that can be closed: what is in it is still given, then None.

    Args:
        newest_first: give the item that came last first.
    """

    def __init__(self, size: int, items: Iterable[T] = (), newest_first: bool = False) -> None:
        self._items = deque(items)
        self._size = size
        self._take = self._items.pop if newest_first else self._items.popleft
        self._changed = threading.Condition()
        self._closed = False

    def put(self, item: T) -> bool:
        """Waits for room; False, and the item is not taken, where the channel is closed."""
        with self._changed:
            while len(self._items) >= self._size and not self._closed:
                self._changed.wait()
            if not self._closed:
                self._items.append(item)
                self._changed.notify_all()
            return not self._closed

    def put_newest(self, item: T) -> T | None:
        """Never waits: where there is no room, the oldest item leaves and is returned."""
        with self._changed:
            left = self._items.popleft() if len(self._items) >= self._size else None
            self._items.append(item)
            self._changed.notify_all()
            return left

    def get(self, wait: bool = True) -> T | None:
        """The next item; None where there is none and the channel is closed or is not to be waited for."""
        with self._changed:
            while wait and not self._items and not self._closed:
                self._changed.wait()
            item = self._take() if self._items else None
            self._changed.notify_all()
            return item

    def is_empty(self) -> bool:
        """Whether there is no item now."""
        return not self._items

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()


class InOrder(Generic[T]):
    """Ends in the order in which they began what several threads do side by side.

    A thread that is done before its turn leaves its piece to the one that has the turn.

    Args:
        end: called with one piece after the other, by any of the threads; False stops.
        most: pieces that have begun and not ended, at most.

    Attributes:
        begun: pieces that have begun.
    """

    def __init__(self, end: Callable[[T], bool], most: int) -> None:
        self._end, self._most = end, most
        self._done: dict[int, T] = {}
        self.begun = self._ended = 0
        self._ending = self._stopped = False
        self._changed = threading.Condition()

    def wait_for_room(self) -> bool:
        """Until another may begin; False after a stop."""
        with self._changed:
            self._changed.wait_for(lambda: self._stopped or self.begun - self._ended < self._most)
            return not self._stopped

    def wait_for_all(self) -> bool:
        """Until all that have begun have ended; False after a stop."""
        with self._changed:
            self._changed.wait_for(lambda: self._stopped or self._ended == self.begun)
            return not self._stopped

    def begin(self) -> int:
        """The number of a piece that begins, by one thread at a time."""
        self.begun += 1
        return self.begun - 1

    def done(self, number: int, piece: T) -> None:
        """Ends a piece, and those that wait for it, unless one before it is missing."""
        with self._changed:
            self._done[number] = piece
            if self._ending:
                return
            self._ending = True
        while True:
            with self._changed:
                if self._ended not in self._done:
                    self._ending = False
                    return
                piece = self._done.pop(self._ended)
            going = self._end(piece)
            with self._changed:
                self._ended += 1
                self._stopped |= not going
                self._changed.notify_all()

    def stop(self) -> None:
        """Nothing begins any more; what has begun before the first that does not come still ends."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()


class Slot:
    """Room for one frame: both views (1, 1, H, W), and the tensors that the graph reads them from without a copy."""

    def __init__(self, bundle: Bundle) -> None:
        shape = (1, 1, bundle.height, bundle.width)
        self.number = 0
        self.arrival = 0.0
        self.views = {name: np.zeros(shape, bundle.dtype) for name in ("contact_view", "topography_view")}
        self.values = {name: ort.OrtValue.ortvalue_from_numpy(view) for name, view in self.views.items()}

    def fill(self, frame: Array, scene: Scene, bundle: Bundle, source: str) -> None:
        """Copies the views out of a frame; raises PlayerError where its size or depth is another one."""
        needed = [max(ends) for ends in zip(*((v.rows[1], v.columns[1]) for v in _views(scene).values()), strict=True)]
        if frame.ndim != 2 or frame.shape[0] < needed[0] or frame.shape[1] < needed[1]:
            raise PlayerError(
                f"{source}: a frame is {frame.shape}, the views of the scene need (H, W) of at least {tuple(needed)}; "
                "correct [views] of the scene or the size that the camera is set to"
            )
        if frame.dtype != bundle.dtype:
            raise PlayerError(
                f"{source}: a frame is {frame.dtype}, the bundle takes {bundle.dtype} (bit_depth {bundle.bit_depth}); "
                "set the camera to that depth or export a bundle with the camera's"
            )
        for name, view in _views(scene).items():
            np.copyto(self.views[name][0, 0], view.crop(frame))
            if 8 < bundle.bit_depth < 16 and self.views[name].max() >> bundle.bit_depth:
                raise PlayerError(
                    f"{source}: a frame holds {self.views[name].max()}, more than the {bundle.bit_depth} bits of the "
                    "bundle; export one with the camera's bit_depth"
                )


def _views(scene: Scene) -> dict[str, View]:
    return {"contact_view": scene.contact, "topography_view": scene.topography}


# --- the graphs, frame by frame ---------------------------------------------------------------------------------------

_NUMPY = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(uint8)": np.uint8,
    "tensor(uint16)": np.uint16,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
    "tensor(bool)": np.bool_,
}


class _Tensor(NamedTuple):
    """Name, shape and type of an input or output; a batch that is free is 1."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @classmethod
    def of(cls, argument: Any, path: Path) -> _Tensor:
        shape = [1 if place == 0 and not isinstance(size, int) else size for place, size in enumerate(argument.shape)]
        if not all(isinstance(size, int) for size in shape) or argument.type not in _NUMPY:
            raise PlayerError(
                f"{path}: {argument.name} is {argument.type} {argument.shape}; the player needs fixed sizes: export "
                "the bundle with them"
            )
        return cls(argument.name, tuple(shape), np.dtype(_NUMPY[argument.type]))


class Motion(NamedTuple):
    """Where points are expected: where each was seen last, and on at its own speed.

    A speed is the mean of those seen, the last one with half the weight: that of two positions alone would carry their
    noise as many frames ahead as are asked for.

    Attributes:
        place: (1, N, 2) px in frame `number`, NaN where there is no point.
        speed: px a frame.
        seen: whether it was, in that frame.
    """

    place: Array
    speed: Array
    seen: Array
    number: int

    @classmethod
    def at_rest(cls, points: Array, number: int) -> Motion:
        """Points (1, N, 2) px of a frame."""
        return cls(points, np.zeros_like(points), np.isfinite(points), number)

    def see(self, points: Array, number: int) -> Motion:
        """After a later frame with these points, NaN where lost."""
        frames = max(1, number - self.number)  # in the frame in which they were chosen they are at rest
        seen = np.isfinite(points)
        # One that was lost may be found beside where it was expected, which is no motion.
        faster = np.where(seen & self.seen, _NEWEST * ((points - self.place) / frames - self.speed), 0)
        lasting = np.where(seen, 1, 1 - 1 / _TRUSTED).astype(points.dtype)
        moved = self.speed * min(frames, _TRUSTED)
        return Motion(np.where(seen, points, self.place + moved), self.speed * lasting + faster, seen, number)

    def without(self, points: Array) -> Motion:
        """Those that are NaN in `points` (1, N, 2) are not followed any more."""
        return self._replace(place=np.where(np.isfinite(points), self.place, np.nan).astype(points.dtype))

    def expect(self, number: int) -> Array:
        """(1, N, 2) px in a frame that may not have come yet."""
        return self.place + self.speed * min(number - self.number, _TRUSTED)


_NEWEST = 0.5  # weight of the speed seen last
_TRUSTED = 4  # frames that a speed is good for: after them a point waits for what comes


_OF_TEMPLATES = ("stale", "warp")  # outputs of `frame` that say which templates to renew, and how
LAG = 2  # frames: each begins from what the one before the last has found, whether or not a newer one has ended


class Stepper:
    """State of a stream, and what leads from one frame to the next.

    Two graphs run for a frame. `frame` needs of the frames before only where points are expected: so frames run side by
    side, each from the motion that was known `lag` frames before it. `fields` runs when a frame is finished, one after
    the other, and has states: an output ``next_X`` is the next frame's input ``X``. Other inputs are tensors that the
    graphs `background` and `key` gave and that are held until these run again, and constants of the scene.

    Frames begin and are finished in their order. What a frame gives depends on the frames before it and on nothing
    else, neither the clock nor which of them happened to be done.

    Where the scene gives no threshold, nothing touches until one was measured and set.

    Args:
        parallel: frames that run side by side, at most.

    Attributes:
        lag: frames that have begun and are not finished, at most.
        outputs: of both graphs, by name; states are left out.
        threshold: relative intensity loss above which a pixel touches; NaN while unknown.
        measures: whether the threshold is found in frames, by the graph `contact`.
        found, keyed: points found at the last restart, and given to the last key frame.
    """

    def __init__(self, engine: Engine, scene: Scene, background: Array, dark: Array, parallel: int = 1) -> None:
        self._bundle, self._engine = engine.bundle, engine
        self._sessions = {name: engine.frame if name == "frame" else engine.open(name) for name in GRAPHS}
        inputs = {name: self._tensors(name, "get_inputs") for name in GRAPHS}
        outputs = {name: self._tensors(name, "get_outputs") for name in GRAPHS}
        self.threshold = math.nan if scene.threshold is None else scene.threshold
        self.measures = scene.threshold is None and "threshold" in inputs["background"]
        if self.measures:
            self._sessions[_MEASURING] = self._open_measuring()
        states = [name for name in inputs["fields"] if f"next_{name}" in outputs["fields"]]
        results = {name: tensor for name, tensor in outputs["fields"].items() if name.removeprefix("next_") == name}
        self.outputs = {name: one for name, one in (outputs["frame"] | results).items() if name not in _OF_TEMPLATES}
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
        self._renewed = inputs["renew"]["points"].shape[1]  # points in a call
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
        self._measured = [math.nan for _ in sides]
        self._motions = [Motion.at_rest(np.empty(0), 0) for _ in sides]
        constants = self._constants("frame", inputs["frame"], {"prediction", *held})
        self._bindings = [self._binding(side, constants) for side in sides]
        self._begun = self._finished = 0

        # One side of the states is read and the other written, in turns.
        self._states = [{name: self._room(inputs["fields"][name]) for name in states} for _ in range(2)]
        self._fields = {name: np.zeros(tensor.shape, tensor.dtype) for name, tensor in results.items()}
        constants = self._constants("fields", inputs["fields"], {*states, *outputs["frame"]})
        self._field_bindings = [self._field_binding(side, constants) for side in range(2)]
        self._of_frame = [name for name in inputs["fields"] if name in outputs["frame"]]

        self._glass = {"background": background[None, None], "dark": dark[None, None]}
        self.use(self.threshold)

    def warm_up(self) -> None:
        """Runs every graph on an empty frame: the first run finds out how much memory it takes, the second lays it out,
        which makes both slow."""
        slot = Slot(self._bundle)
        for _ in range(2):
            self.restart(slot, self.choose(slot))
            side = self.begin(slot, measure=self.measures)
            self.run(side)
            self.finish(side)
            some = self._held["template_start"][:, : self._renewed]
            self.prepared(some, np.broadcast_to(np.eye(2), (*some.shape, 2)))

    def choose(self, slot: Slot) -> Array:
        """Points (1, N, 2) px worth tracking in a frame, NaN beyond those that were found."""
        given = {"topography_view": slot.views["topography_view"], "mask": self._mask}
        return self._run("detect", given)["points"]

    def restart(self, slot: Slot, points: Array) -> None:
        """Follows these points of a frame from now on and makes it the key frame; all states become unknown."""
        self.found = _count_known(points)
        for value in self._states[self._finished % 2].values():
            state = value.numpy()
            value.update_inplace(np.full(state.shape, np.nan if state.dtype.kind == "f" else 0, state.dtype))
        self._motions = [Motion.at_rest(points, slot.number) for _ in self._motions]
        self.key(slot, points)

    def key(self, slot: Slot, points: Array) -> None:
        """Makes a frame the one with which the next ones are compared, from the points (1, N, 2) found in it."""
        self._hold(self._run("key", {"topography_view": slot.views["topography_view"], "points": points}))
        self._motions = [motion.without(points) for motion in self._motions]
        self.keyed = _count_known(points)

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
        self._hold(self._run("background", {**self._glass, "threshold": np.array([threshold])}))

    def begin(self, slot: Slot, measure: bool = False) -> int:
        """Makes ready to compute a frame, and to measure the threshold in it; gives the side that `run` and `finish`
        are to be called with."""
        side = self._begun % len(self._bindings)
        motion = self._motions[(self._begun - self.lag) % len(self._motions)]
        self._begun += 1
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
            found = self._run(_MEASURING, {"contact_view": slot.views["contact_view"]})["threshold"][0]
            # An empty glass has a threshold too, of noise or below none.
            self._measured[side] = float(found) if 0 < found < 1 else math.nan

    def finish(self, side: int) -> dict[str, Array]:
        """Outputs by name, (1, ...), of a frame that has run; valid until the next one is finished."""
        results, number = self._results[side], self._numbers[side]
        before = self._motions[(side - 1) % len(self._motions)]
        self._motions[side] = before.see(results["points"], number)
        binding = self._field_bindings[self._finished % 2]
        for name in self._of_frame:
            binding.bind_ortvalue_input(name, self._values[side][name])
        self._sessions["fields"].run_with_iobinding(binding)
        self._finished += 1
        return results | self._fields

    def measured(self, side: int) -> float | None:
        """The threshold found in a frame, NaN where it shows no contact; None where it was not asked for."""
        return None if self._slots[side] is None else self._measured[side]

    def _tensors(self, graph: str, side: str) -> dict[str, _Tensor]:
        arguments = getattr(self._sessions[graph], side)()
        return {argument.name: _Tensor.of(argument, self._bundle.files[graph]) for argument in arguments}

    def _room(self, tensor: _Tensor) -> Any:
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
        if _MEASURING not in self._bundle.files:
            raise PlayerError(
                f"{self._bundle.files['background']}: takes a threshold, the scene has no number for it and the bundle "
                "no contact.onnx that would measure it; add [contact] threshold = with the relative intensity loss "
                'that counts as contact, such as 0.25, or export the bundle with the graph "contact"'
            )
        return self._engine.open(_MEASURING)

    def _constants(self, graph: str, inputs: Mapping[str, _Tensor], known: set[str]) -> dict[str, Any]:
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
                    f"{path}: needs an input {name!r} that this player does not know; use the player.py of its bundle"
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
        for name, value in {**constants, **self._states[side]}.items():
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


class Renewal:
    """Templates that are to be prepared anew, in pieces by whoever has time.

    Args:
        rows: of the templates.
        start, warp: (1, rows, 2) px of the key frame, (1, rows, 2, 2) deformation.
        size: rows of a piece.
    """

    def __init__(self, rows: Array, start: Array, warp: Array, size: int) -> None:
        self.rows, self._start, self._warp, self._size = rows, start, warp, size
        self._pieces: list[Future[dict[str, Array]]] = [Future() for _ in range(0, len(rows), size)]
        self._open = deque(range(len(self._pieces)))

    def prepare_piece(self, prepared: Callable[[Array, Array], dict[str, Array]]) -> bool:
        """The next piece; False where none is left that nobody has begun."""
        try:
            number = self._open.popleft()
        except IndexError:
            return False
        part = slice(number * self._size, (number + 1) * self._size)
        try:
            self._pieces[number].set_result(prepared(self._start[:, part], self._warp[:, part]))
        except BaseException as error:
            self._pieces[number].set_exception(error)
            raise
        return True

    def templates(self, prepared: Callable[[Array, Array], dict[str, Array]]) -> dict[str, Array]:
        """Arrays (1, rows, ...) by the names of what is held, when all pieces are done: those left, by the caller."""
        while self.prepare_piece(prepared):
            pass
        done = [piece.result() for piece in self._pieces]
        return {name: np.concatenate([one[name] for one in done], axis=1) for name in done[0]}


def _count_known(points: Array) -> int:
    return int(np.isfinite(points).all(-1).sum())


class ThresholdSearch:
    """In which frames the threshold is measured, and from which on it counts: by the order of the frames alone.

    Every fourth frame is tried until one shows contact. What is found there, where a contact is small, is measured
    again whenever the contact has grown by a fourth.

    Methods are called for frame after frame, `due` and `wants` when it begins, `see` when it has ended.

    Args:
        lag: frames after which what one has found counts.
    """

    _EVERY, _GROWTH = 4, 1.25

    def __init__(self, lag: int) -> None:
        self._lag = lag
        self._searching = True
        self._area = math.nan  # at which the threshold was measured that is in use
        self._asked: int | None = None  # frame in which the contact had grown
        self._found: tuple[int, float] | None = None

    def begin(self) -> None:
        """Points were chosen anew: the threshold in use stays until contact is found."""
        self._searching, self._asked, self._found = True, None, None

    def due(self, index: int) -> float | None:
        """The threshold that counts from this frame on, None for that in use."""
        found = self._found
        return found[1] if found is not None and index >= found[0] + self._lag else None

    def used(self) -> None:
        """That threshold is in use now; all frames before have ended."""
        self._searching, self._area, self._asked, self._found = False, math.nan, None, None

    def wants(self, index: int) -> bool:
        """Whether the threshold is to be measured in this frame."""
        if self._searching:
            return index % self._EVERY == 0
        return self._asked is not None and index == self._asked + self._lag

    def see(self, index: int, area: float, measured: float | None) -> bool:
        """The area that touched in a frame, and the threshold found in it: NaN for none, None where that was not asked.
        True where it is to be used."""
        if self._found is not None:
            return False
        if measured is not None and math.isfinite(measured):
            self._found = index, measured
        elif math.isnan(self._area) or (measured is not None and not self._searching):
            self._area, self._asked = area, None
        elif not self._searching and self._asked is None and area > self._GROWTH * self._area:
            self._asked = index
        return self._found is not None


class Upkeep:
    """When points are chosen anew or followed from a newer key frame: by the order and numbers of the frames alone.

    Args:
        share: a new key frame when less than this share of its points is tracked, several frames in a row.
        frames: a new key frame after so many frames.
    """

    _IN_A_ROW = 4  # a single frame may be blurred or dark
    _RESTART = 64  # frames between two choices of points, each of which takes as long as ten frames

    def __init__(self, share: float, frames: float) -> None:
        self._share, self._frames = share, frames
        self.key_frame = 0
        self._found = self._keyed = self._few = self._lost = self._tried = 0

    def restarted(self, index: int, key_frame: int, found: int) -> None:
        """Before frame `index` so many points were chosen in a frame."""
        self.keyed(key_frame, found)
        self._found, self._tried, self._lost = found, index, 0

    def keyed(self, key_frame: int, points: int) -> None:
        """So many points are followed from a new key frame."""
        self.key_frame, self._keyed, self._few = key_frame, points, 0

    def kept(self, index: int) -> None:
        """Before frame `index` no better points were to be had."""
        self._tried = index

    def see(self, index: int, number: int, tracked: int) -> str:
        """Why something is to change after a frame in which so many points were tracked; empty for nothing."""
        self._lost = self._lost + 1 if tracked < max(self._found / 2, 1) else 0
        self._few = self._few + 1 if tracked < self._share * self._keyed else 0
        if self._lost >= self._IN_A_ROW and index - self._tried >= self._RESTART:
            return "lost"
        if tracked and (self._few >= self._IN_A_ROW or number - self.key_frame >= self._frames):
            return _REKEY
        return ""


def _region_mask(scene: Scene, shape: tuple[int, ...]) -> Array:
    mask = np.zeros(shape, np.bool_)
    region = scene.region or View((0, shape[-2]), (0, shape[-1]))
    region.crop(mask[0, 0])[...] = True
    return mask


# --- results ----------------------------------------------------------------------------------------------------------

_IN_MM = {  # outputs in px that are stored in mm: name, power of mm_per_px
    "real_area_px": ("real_area_mm2", 2),
    "gross_area_px": ("gross_area_mm2", 2),
    "semi_axes": ("semi_axes_mm", 1),
}
_OWN_FIELDS = [  # name, type, unit of what the player adds to a record
    ("frame", "<i8", "number of the frame as it came in, or in its file, from 0; gaps are dropped frames"),
    ("time", "<f8", "s since the first frame"),
    ("latency", "<f4", "s from the frame's arrival to its result"),
    ("key_frame", "<i8", "number of the frame with which this one was compared"),
    ("restart", "<i4", "how often points had been chosen anew; points of different restarts are different points"),
]
_MATLAB = {"f4": "single", "f8": "double", "u1": "uint8", "u2": "uint16", "i4": "int32", "i8": "int64"}
_STORED = {np.dtype(np.bool_): "|u1", np.dtype(np.float16): "<f4"}


class StreamResults(NamedTuple):
    """What `read_results` gives: one record a processed frame, the header, and what happened beside the frames."""

    records: Array
    header: dict[str, Any]
    events: list[dict[str, Any]]


def read_results(folder: str | Path) -> StreamResults:
    """Reads a results folder, also one that is being written or whose writer was killed: the whole records of it.

    ``records`` is a structured array mapped from the file: ``records["real_area_mm2"]`` (F,), ``records["points"]``
    (F, N, 2). Raises PlayerError where it is no results folder.
    """
    folder = Path(folder)
    try:
        header = json.loads((folder / "header.json").read_text(encoding="utf-8"))
        if header["format"] != RESULTS_FORMAT:
            raise PlayerError(f"{folder}: results of format {header['format']}, this player reads {RESULTS_FORMAT}")
        dtype = np.dtype([(f["name"], f["dtype"], tuple(f["shape"])) for f in header["fields"]])
        count = (folder / "records.bin").stat().st_size // dtype.itemsize
        lines = (folder / "events.jsonl").read_text(encoding="utf-8").splitlines(keepends=True)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PlayerError(f"{folder}: is no results folder of a stream ({error})") from None
    records = np.memmap(folder / "records.bin", dtype, "r", shape=(count,)) if count else np.empty(0, dtype)
    return StreamResults(records, header, [json.loads(line) for line in lines if line.endswith("\n")])


def write_table(folder: str | Path, table: str | Path) -> None:
    """Writes the scalars of a results folder as CSV, one row a frame; raises PlayerError where the file exists."""
    records = read_results(folder).records
    names = [name for name in records.dtype.names or () if records.dtype[name].shape in ((), (2,))]
    columns: dict[str, Array] = {}
    for name in names:
        pair = records.dtype[name].shape == (2,)
        columns |= {f"{name}_{i + 1}": records[name][:, i] for i in range(2)} if pair else {name: records[name]}
    try:
        with open(table, "x", encoding="utf-8") as file:
            file.write(",".join(columns) + "\n")
            for row in zip(*(column.tolist() for column in columns.values()), strict=True):
                file.write(",".join(f"{value:.9g}" for value in row) + "\n")
    except OSError as error:
        raise PlayerError(
            f"{table}: cannot be written ({error.strerror}); name a new file where there is room"
        ) from None


class Sink:
    """Appends records to a new folder; a kill loses at most what came since the last second.

    header.json says what a record holds, records.bin has them one after another, events.jsonl what happened when.
    """

    def __init__(self, folder: Path, header: Mapping[str, Any]) -> None:
        self.folder, self._header = folder, header
        self._records: BinaryIO | None = None
        self._events: TextIO | None = None
        self._synced = 0.0
        self._lock = threading.Lock()

    def open(self) -> None:
        """Makes the folder; raises PlayerError where it is there already or cannot be made."""
        with self._said():
            self.folder.mkdir(parents=True)
            with open(self.folder / "header.json", "x", encoding="utf-8") as file:
                file.write(json.dumps(self._header, indent=1) + "\n")
                file.flush()
                os.fsync(file.fileno())
            self._events = open(self.folder / "events.jsonl", "x", encoding="utf-8")  # noqa: SIM115
            self._records = open(self.folder / "records.bin", "xb")  # noqa: SIM115

    def write(self, record: Array) -> None:
        """A record as bytes; once a second all of them go to the disk."""
        assert self._records is not None
        with self._said():
            self._records.write(record.data)
            if time.perf_counter() - self._synced >= 1:
                self.sync()

    def sync(self) -> None:
        assert self._records is not None
        self._synced = time.perf_counter()
        self._records.flush()
        os.fsync(self._records.fileno())

    def event(self, event: str, frame: int, **facts: Any) -> None:
        """One line; may come from any thread."""
        assert self._events is not None
        with self._said(), self._lock:
            line = {"event": event, "frame": frame, "clock": datetime.now(UTC).isoformat(), **facts}
            self._events.write(json.dumps(line) + "\n")
            self._events.flush()

    def close(self) -> None:
        if self._records is None or self._events is None:
            return
        with self._said():
            try:
                self.sync()
            finally:
                for file in (self._records, self._events):
                    # After a full disk the rest cannot be written at the second try either.
                    with contextlib.suppress(OSError):
                        file.close()

    @contextlib.contextmanager
    def _said(self) -> Iterator[None]:
        try:
            yield
        except FileExistsError:
            raise PlayerError(
                f"{self.folder}: exists already and results are never overwritten; give --output another name"
            ) from None
        except OSError as error:
            raise PlayerError(
                f"{self.folder}: cannot be written ({error.strerror}); what was written stays readable. Make room, or "
                "give --output another place"
            ) from None


class RecordLayout:
    """Which outputs of the graphs a record holds, in which units, and how they get there."""

    def __init__(self, outputs: Mapping[str, _Tensor], mm_per_px: float, units: Mapping[str, str]) -> None:
        own: list[tuple[str, str, tuple[int, ...]]] = [(name, kind, ()) for name, kind, _ in _OWN_FIELDS]
        self._copied: list[tuple[str, str, float | None]] = []
        said = {name: unit for name, _, unit in _OWN_FIELDS}
        for name, tensor in outputs.items():
            if len(tensor.shape) > 3:  # images are for the live page
                continue
            stored, power = _IN_MM.get(name, (name, 0))
            self._copied.append((name, stored, mm_per_px**power if power else None))
            own.append((stored, _STORED.get(tensor.dtype, tensor.dtype.newbyteorder("<").str), tensor.shape[1:]))
            said[stored] = {0: units.get(name, ""), 1: "mm", 2: "mm2"}[power]
        self.dtype = np.dtype(own)
        self.fields = [
            {"name": name, "dtype": kind, "shape": shape, "unit": said[name], "matlab": _MATLAB[kind[1:]]}
            for name, kind, shape in own
        ]

    def fill(self, records: Mapping[str, Array], place: int, outputs: Mapping[str, Array]) -> None:
        """Stores the outputs in one of the records, whose fields are given by name."""
        for name, stored, factor in self._copied:
            value = outputs[name][0]
            records[stored][place] = value if factor is None else value * factor


# --- latency ----------------------------------------------------------------------------------------------------------


class Latencies:
    """A histogram of times in bins 1 % wide from 10 µs up to 20 s, so that memory does not grow with the stream."""

    _first, _ratio = 1e-5, 1.01

    def __init__(self) -> None:
        self._counts = np.zeros(1460, np.int64)
        self.count = 0
        self.worst = 0.0

    def add(self, seconds: float) -> None:
        place = math.log(max(seconds, self._first) / self._first) / math.log(self._ratio)
        self._counts[min(int(place), len(self._counts) - 1)] += 1
        self.count += 1
        self.worst = max(self.worst, seconds)

    def quantile(self, share: float) -> float:
        """Seconds, the upper end of a bin; NaN without a time."""
        if not self.count:
            return math.nan
        place = int(np.searchsorted(np.cumsum(self._counts), share * self.count))
        return min(self._first * self._ratio ** (place + 1), self.worst)

    def summary(self) -> dict[str, float | None]:
        """ms."""
        facts = {"median": self.quantile(0.5), "p99": self.quantile(0.99), "worst": self.worst}
        return {name: round(1e3 * value, 3) if self.count else None for name, value in facts.items()}


# --- the player -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Settings:
    """How a stream runs.

    Attributes:
        every: process every frame, the source waits for room; else the newest frame, those it overtakes are dropped.
        queue: frames that wait at most; 1 in the policy `latest`.
        rate: Hz at which a recording is played, None as fast as it goes.
        first: number of the first frame in the source.
        frames: end after so many, None at the source's end.
        give_up: s without a frame after which the stream ends with an error.
        page: host and port of the live page, None for none; port 0 takes a free one.
    """

    every: bool = True
    queue: int = 32
    rate: float | None = None
    first: int = 0
    frames: int | None = None
    give_up: float = 30.0
    page: tuple[str, int] | None = None


_STALL_WARNING = 2.0  # s
_HANGING = 2.0  # s that a stopped stream waits for its source before it is left behind
_REKEY_SHARE = 0.8
_REKEY = "rekey"  # why the key frame changes while its points stay
_PAGE = "page"  # somebody asked for other points
_RENEWAL_FRAMES = 8  # frames after which templates are looked at, and after which what is renewed counts
_TRACE_INTERVAL, _TRACE_LENGTH = 1 / 30, 900  # 30 s of traces on the live page
_STORE_INTERVAL = 0.02  # s
_RECORDS_WAITING = 512  # more than a second's worth, as long as a slow disk may take to sync


class _Change(NamedTuple):
    """The next key frame, and the points found in it: they are followed where the cause is _REKEY, else chosen anew.
    Decided after frame number `after` of those that were computed."""

    after: int
    key: Slot
    points: Array
    cause: str


class _Renewing(NamedTuple):
    """Templates that are renewed from frame number `due` of those that are computed on, unless the key frame is another
    than number `key` then."""

    due: int
    key: int
    work: Renewal


class Player:
    """One stream from source to results; `run` returns when it has ended.

    Raises PlayerError for everything that the user can put right; the results are whole then too.
    """

    def __init__(
        self,
        stepper: Stepper,
        provider: str,
        bundle: Bundle,
        scene: Scene,
        source: Source,
        open_source: OpenSource,
        sink: Sink,
        layout: RecordLayout,
        settings: Settings,
        source_name: str = "source",
    ) -> None:
        self.bundle, self.scene, self.settings, self.source_name = bundle, scene, settings, source_name
        self.provider = provider
        self._stepper, self._sink, self._layout = stepper, sink, layout
        self._source, self._open_source = source, open_source
        # One slot is being filled, some computed, one drawn on the page, one becomes the key frame; the others wait.
        # Their number is the bound.
        slots = [Slot(bundle) for _ in range(settings.queue + 3 + stepper.lag)]
        # The slot that was in use last is still in the processor's cache.
        self._free = Channel(len(slots), slots, newest_first=True)
        self._frames: Channel[Slot] = Channel(len(slots) if settings.every else 1)
        self._records: Channel[tuple[int, LiveViews | None]] = Channel(_RECORDS_WAITING)
        self._room = np.zeros(_RECORDS_WAITING + 2, layout.dtype)  # one is being filled, one written
        self._fields = {name: self._room[name] for name in self._room.dtype.names or ()}  # looked up once
        self.frames_in = self.processed = self.dropped = self.overruns = 0
        self.reconnects = self.stalls = self.restarts = self.keys = 0
        self.latencies, self._recent = Latencies(), Latencies()
        self.tracked = 0
        self.rate, self.recent = math.nan, self.latencies.summary()
        self.page_url = ""
        self.live = LiveData(bundle)
        self.restart_wanted = threading.Event()
        self._stop = threading.Event()
        self._finished = threading.Event()
        self._failure: BaseException | None = None
        self._waiting_since: float | None = None  # for the source
        self._computing = stepper.parallel  # threads
        self._beginning, self._order = threading.Lock(), InOrder(self._end, stepper.lag)
        self._first = math.nan
        self._search = ThresholdSearch(stepper.lag)
        self._upkeep = Upkeep(scene.rekey_share or _REKEY_SHARE, scene.rekey_frames or math.inf)
        self._change: _Change | None = None
        self._renewals: deque[_Renewing] = deque()
        self._drawing = False  # a frame is on its way to the page
        self._last_trouble = ""

    def run(self) -> dict[str, Any]:
        """Plays the stream and returns its summary."""
        after_computing = (self._free.close, self._frames.close, self._close_records)
        threads = [
            threading.Thread(target=self._guard, args=(step, after), name=step.__name__.strip("_"), daemon=True)
            for step, after in (
                (self._capture, (self._frames.close,)),
                *[(self._compute, after_computing)] * self._stepper.parallel,
                (self._store, (self._records.close, self._finished.set)),
            )
        ]
        self._started = time.perf_counter()
        page = serve_page(self, self.settings.page) if self.settings.page else None
        try:
            self._sink.open()
            for thread in threads:
                thread.start()
            self._watch()
            threads[0].join(_HANGING)
            self._frames.close()
            for thread in threads[1:]:
                thread.join()
        finally:
            self._seconds = time.perf_counter() - self._started
            if page:
                page.shutdown()
                page.server_close()
            try:
                self._sink.close()
            except PlayerError as error:
                self._failure = self._failure or error
        if self._failure is not None:
            raise self._failure
        return self.summary()

    def stop(self) -> None:
        """Ends the stream cleanly; frames that came in are still processed."""
        self._stop.set()

    def points(self) -> dict[str, int]:
        """Points that the last frame tracked, of those chosen at the last restart."""
        return {"tracked": self.tracked, "found": self._stepper.found}

    def summary(self) -> dict[str, Any]:
        seconds = getattr(self, "_seconds", time.perf_counter() - self._started)
        return {
            "frames_in": self.frames_in,
            "processed": self.processed,
            "dropped": self.dropped,
            "overruns": self.overruns,
            "reconnects": self.reconnects,
            "stalls": self.stalls,
            "restarts": self.restarts,
            "key_frames": self.keys,
            "seconds": round(seconds, 3),
            "rate_hz": round(self.processed / seconds, 2),
            "latency_ms": self.latencies.summary(),
            "threshold": self._stepper.threshold if math.isfinite(self._stepper.threshold) else None,
            "results": str(self._sink.folder),
        }

    def _guard(self, step: Callable[[], None], after: Iterable[Callable[[], Any]]) -> None:
        """Runs a thread; its failure ends the others, and each ends those that wait for it."""
        try:
            step()
        except BaseException as error:
            if self._failure is None:
                self._failure = error
            self._stop.set()
        finally:
            for close in after:
                close()

    # Main thread: the log, and whether the source still gives frames.

    def _watch(self) -> None:
        said, processed, stalled = time.perf_counter(), 0, False
        while not self._finished.wait(0.05) and not self._stop.is_set():
            now = time.perf_counter()
            since = self._waiting_since
            silent = now - since if since is not None else 0.0
            if silent > _STALL_WARNING and not stalled:
                self.stalls += 1
                log.warning("%s: no frame for %.0f s", self.source_name, silent)
                self._sink.event("stall", self.settings.first + self.frames_in)
            stalled = silent > _STALL_WARNING
            if silent > self.settings.give_up:
                trouble = f" (last error: {self._last_trouble})" if self._last_trouble else ""
                self._failure = self._failure or PlayerError(
                    f"{self.source_name}: no frame for {silent:.0f} s{trouble}; check the camera and its cable, or "
                    "give more time with --give-up"
                )
                self._stop.set()
            if now - said >= 1:
                recent, self._recent = self._recent, Latencies()
                self.recent = recent.summary()
                self.rate = (self.processed - processed) / (now - said)
                said, processed = now, self.processed
                log.info("%s", self._line(self.recent))

    def _line(self, latency: Mapping[str, float | None]) -> str:
        times = ", ".join(f"{name} {value}" for name, value in latency.items())
        return (
            f"{self.rate:.1f} frames/s; in {self.frames_in}, processed {self.processed}, dropped {self.dropped}, "
            f"overruns {self.overruns}; latency ms: {times}; points {self.tracked} of {self._stepper.found}"
        )

    # Capture: source -> frames.

    def _capture(self) -> None:
        source: Source | None = self._source
        attempt, start = 0, math.nan
        try:
            while not self._stop.is_set() and self.frames_in != self.settings.frames:
                self._waiting_since = self._waiting_since or time.perf_counter()
                try:
                    source = source or self._open_source(self.settings.first + self.frames_in)
                    frame = source.read()
                except PlayerError:
                    raise
                except Exception as error:
                    self._lost(source, error, attempt)
                    source, attempt = None, attempt + 1
                    continue
                self._waiting_since, attempt = None, 0
                if frame is None:
                    break
                arrival = time.perf_counter()
                if self.settings.rate is not None and not source.live:
                    start = arrival if math.isnan(start) else start
                    # A camera of that rate gives the frame at this time: being late after it counts as latency.
                    arrival = start + self.frames_in / self.settings.rate
                    if (wait := arrival - time.perf_counter()) > 0:
                        time.sleep(wait) if wait < 0.1 else self._stop.wait(wait)
                self._take(frame, arrival, source.live or self.settings.rate is not None)
        finally:
            self._waiting_since = None
            if source is not None:
                _close_quietly(source)

    def _lost(self, source: Source | None, error: Exception, attempt: int) -> None:
        """After an error of the source: it is closed and opened again, later and later."""
        self._last_trouble = f"{type(error).__name__}: {_first_line(error)}"
        self.reconnects += 1
        delay = min(0.1 * 2**attempt, 5.0)
        log.warning("%s: %s; trying again in %.1f s", self.source_name, self._last_trouble, delay)
        self._sink.event("reconnect", self.settings.first + self.frames_in, error=self._last_trouble)
        if source is not None:
            _close_quietly(source)
        self._stop.wait(delay)

    def _take(self, frame: Array, arrival: float, cannot_wait: bool) -> None:
        slot = self._free.get(wait=False)
        if slot is None:
            self.overruns += cannot_wait
            slot = self._free.get()
        if slot is None:  # the stream has failed
            return
        slot.number, slot.arrival = self.settings.first + self.frames_in, arrival
        slot.fill(frame, self.scene, self.bundle, self.source_name)
        self.frames_in += 1
        if self.settings.every:
            self._frames.put(slot)
        elif (overtaken := self._frames.put_newest(slot)) is not None:
            self.dropped += 1
            self._free.put(overtaken)

    # Compute: frames -> records, in as many threads as frames are computed side by side.

    def _compute(self) -> None:
        try:
            while (begun := self._begin()) is not None:
                number, (slot, side) = begun
                self._stepper.run(side)
                self._order.done(number, (slot, side))
                # Not while frames are ended: others would wait.
                any(one.work.prepare_piece(self._stepper.prepared) for one in tuple(self._renewals))
        except BaseException:
            self._order.stop()
            raise

    def _begin(self) -> tuple[int, tuple[Slot, int]] | None:
        """The next frame; None where there is none or the stream has failed."""
        with self._beginning:
            if not self._order.wait_for_room():
                return None
            slot = self._frames.get()
            if slot is None or not self._prepare(slot, self._order.begun):
                return None
            measure = self._stepper.measures and self._search.wants(self._order.begun)
            side = self._stepper.begin(slot, measure)
            return self._order.begin(), (slot, side)

    def _close_records(self) -> None:
        """After the last of these threads no record comes."""
        with self._beginning:
            self._computing -= 1
            if not self._computing:
                self._records.close()

    def _prepare(self, slot: Slot, index: int) -> bool:
        """What changes before a frame begins; False where the stream has failed."""
        change, threshold = self._change, self._search.due(index)
        if index == 0:
            self._first = slot.arrival
            self._restart(index, slot, self._stepper.choose(slot), "start")
        if change is not None and index < change.after + self._stepper.lag:
            change = None
        due = self._renewals and index >= self._renewals[0].due
        if change is None and threshold is None and not due:
            return True
        templates = self._renewals[0].work.templates(self._stepper.prepared) if due else {}
        if not self._order.wait_for_all():  # they read what changes now
            return False
        if threshold is not None:
            self._stepper.use(threshold)
            self._search.used()
        if due and (renewing := self._renewals.popleft()).key == self.restarts + self.keys:
            self._stepper.renew(renewing.work.rows, templates)
        if change is not None:
            if change.cause == _REKEY:
                self._rekey(change.key, change.points)
            else:
                self._choose(index, change)
            self._change = None
            self._free.put(change.key)
        return True

    def _choose(self, index: int, change: _Change) -> None:
        """Takes new points where they are more than those that are followed."""
        points = self._stepper.choose(change.key)
        if _count_known(points) > (0 if change.cause == _PAGE else _count_known(change.points)):
            self._restart(index, change.key, points, change.cause)
        else:
            self._upkeep.kept(index)

    def _restart(self, index: int, slot: Slot, points: Array, cause: str) -> None:
        self._stepper.restart(slot, points)
        self._upkeep.restarted(index, slot.number, self._stepper.found)
        self._search.begin()
        self.restarts += 1
        self._sink.event("restart", slot.number, cause=cause, points=self._stepper.found)
        log.info("frame %d: %d points chosen (%s)", slot.number, self._stepper.found, cause)

    def _rekey(self, slot: Slot, points: Array) -> None:
        self._stepper.key(slot, points)
        self._upkeep.keyed(slot.number, self._stepper.keyed)
        self.keys += 1
        self._sink.event("key_frame", slot.number, points=self._stepper.keyed)

    def _end(self, computed: tuple[Slot, int]) -> bool:
        """Hands a record on and decides whether something is to change; False where the stream has failed."""
        slot, side = computed
        outputs = self._stepper.finish(side)
        index = self.processed
        place = index % len(self._room)
        self._fill(slot, outputs, place)
        if self._stepper.measures:
            self._learn_threshold(slot, index, float(outputs["real_area_px"][0]), self._stepper.measured(side))
        if (index + 1) % _RENEWAL_FRAMES == 0:
            self._look_at_templates(index, outputs)
        drawn = None
        if self._change is None and (cause := self._cause_to_change(slot, index)):
            self._change = _Change(index, slot, outputs["points"].copy(), cause)
        elif not self._drawing and self.live.is_due():
            self._drawing = True
            real_contact_mask = outputs.get("real_contact_mask")
            drawn = LiveViews(slot, None if real_contact_mask is None else real_contact_mask.copy())
        else:
            self._free.put(slot)
        return self._records.put((place, drawn))

    def _look_at_templates(self, index: int, outputs: dict[str, Array]) -> None:
        key = self.restarts + self.keys
        under_way = [one.work.rows for one in self._renewals if one.key == key]  # those that are due are gone
        work = self._stepper.stale(outputs, np.concatenate([np.empty(0, int), *under_way]))
        if work is not None:
            self._renewals.append(_Renewing(index + 1 + _RENEWAL_FRAMES, key, work))

    def _cause_to_change(self, slot: Slot, index: int) -> str:
        """Why points are to be chosen anew, or kept and compared with this frame; empty for neither."""
        if self.restart_wanted.is_set():
            self.restart_wanted.clear()
            return _PAGE
        return self._upkeep.see(index, slot.number, self.tracked)

    def _learn_threshold(self, slot: Slot, index: int, area: float, measured: float | None) -> None:
        if self._search.see(index, area, measured) and measured is not None:
            self._sink.event("threshold", slot.number, threshold=measured)
            log.info("frame %d: threshold %.4f of the intensity lost", slot.number, measured)

    def _fill(self, slot: Slot, outputs: dict[str, Array], place: int) -> None:
        self._layout.fill(self._fields, place, outputs)
        self.tracked = int(np.isfinite(outputs["points"][0, :, 0]).sum())
        latency = time.perf_counter() - slot.arrival
        for name, value in (
            *(("frame", slot.number), ("time", slot.arrival - self._first), ("latency", latency)),
            *(("key_frame", self._upkeep.key_frame), ("restart", self.restarts)),
        ):
            self._fields[name][place] = value
        self.latencies.add(latency)
        self._recent.add(latency)
        self.processed += 1

    # Sink: records -> disk and page.

    def _store(self) -> None:
        as_bytes = self._room.view(np.uint8).reshape(len(self._room), -1)
        traced = -math.inf
        while (item := self._records.get()) is not None:
            place, views = item
            record = self._room[place]
            if views is not None:
                self.live.show(record, views)
                self._free.put(views.slot)
                self._drawing = False
            if record["time"] - traced >= _TRACE_INTERVAL:
                traced = float(record["time"])
                self.live.trace(record)
            self._sink.write(as_bytes[place])
            if self._records.is_empty():  # to be woken for several records instead of for each
                time.sleep(_STORE_INTERVAL)


def _close_quietly(source: Source) -> None:
    """A source that fails to close is gone all the same."""
    try:
        source.close()
    except Exception as error:
        log.warning("closing the source: %s", _first_line(error))


# --- live page --------------------------------------------------------------------------------------------------------

_PAGE_INTERVAL = 1 / 15  # s between pictures, made only while somebody looks
_PAGE_SIDE = 400  # px; larger views are sent with every 2nd, 3rd ... pixel


class LiveViews(NamedTuple):
    """What a picture is drawn from: a frame, and the (1, 1, H, W) real-contact mask where the recipe has it."""

    slot: Slot
    real_contact_mask: Array | None


class LiveData:
    """The latest picture and the traces, written by the sink and read by the page."""

    def __init__(self, bundle: Bundle) -> None:
        self._every = -(-max(bundle.height, bundle.width) // _PAGE_SIDE)
        self._shift = bundle.bit_depth - 8
        self._asked = self._drawn = -math.inf
        self._arrays: dict[str, Array] = {}
        self._scalars: dict[str, float] = {}
        self._traces: deque[tuple[float, float, float, float]] = deque(maxlen=_TRACE_LENGTH)

    def is_due(self) -> bool:
        """Whether somebody looks, and the last picture is old enough."""
        now = time.perf_counter()
        if now - self._asked > 2 or now - self._drawn < _PAGE_INTERVAL:
            return False
        self._drawn = now
        return True

    def show(self, record: Array, views: LiveViews) -> None:
        """Keeps a small picture of a frame and its result."""
        arrays = {
            name: (view[0, 0, :: self._every, :: self._every] >> self._shift).astype(np.uint8)
            for name, view in views.slot.views.items()
        }
        if views.real_contact_mask is not None:
            arrays["real_contact_mask"] = views.real_contact_mask[0, 0, :: self._every, :: self._every].astype(np.uint8)
        names = record.dtype.names or ()
        arrays |= {
            n: record[n].astype(np.float32) for n in ("points", "divergence", "center", "semi_axes_mm") if n in names
        }
        self._scalars = {name: float(record[name]) for name in names if record.dtype[name].shape == ()}
        self._arrays = arrays

    def trace(self, record: Array) -> None:
        names = record.dtype.names or ()
        wanted = ("time", "real_area_mm2", "gross_area_mm2", "median_divergence")
        self._traces.append(tuple(float(record[n]) if n in names else math.nan for n in wanted))  # type: ignore[arg-type]

    def packed(self, facts: Mapping[str, Any]) -> bytes:
        """Length of a JSON text (little-endian uint32), the text, and the arrays it lists, each padded to 4 bytes."""
        self._asked = time.perf_counter()
        arrays = self._arrays | {"traces": np.array(list(self._traces), np.float32).reshape(-1, 4)}
        listed = [{"name": n, "type": str(a.dtype), "shape": a.shape} for n, a in arrays.items()]
        scalars = {name: value if math.isfinite(value) else None for name, value in self._scalars.items()}
        text = json.dumps({**facts, "every": self._every, "scalars": scalars, "arrays": listed}).encode()
        blocks = [struct.pack("<I", len(text)), text, b"\0" * (-len(text) % 4)]
        for array in arrays.values():
            blocks += [array.tobytes(), b"\0" * (-array.nbytes % 4)]
        return b"".join(blocks)


def serve_page(player: Player, address: tuple[str, int]) -> ThreadingHTTPServer:
    """Starts the live page in a thread of its own; raises PlayerError where the address is taken."""
    facts = {
        "bundle": player.bundle.folder.resolve().name,
        "provider": PROVIDERS[player.provider],
        "mm_per_px": player.scene.mm_per_px,
        "source": player.source_name,
    }

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            if self.path == "/":
                self._answer(200, "text/html; charset=utf-8", PAGE.encode())
            elif self.path == "/live":
                rate = None if math.isnan(player.rate) else player.rate
                now = {"rate": rate, "recent_ms": player.recent, **player.points(), **player.summary()}
                self._answer(200, "application/octet-stream", player.live.packed({**facts, **now}))
            else:
                self._answer(404, "text/plain", b"not here")

        def do_POST(self) -> None:
            # A page of another site cannot send this header: the stream is restarted by its own page only.
            if self.path == "/restart" and self.headers.get("X-Fingerflow"):
                player.restart_wanted.set()
                self._answer(204, "text/plain", b"")
            else:
                self._answer(403, "text/plain", b"refused")

        def _answer(self, status: int, kind: str, body: bytes) -> None:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:
            """Fifteen requests a second are no news."""

    try:
        server = ThreadingHTTPServer(address, Handler)
    except OSError as error:
        raise PlayerError(
            f"live page: {address[0]}:{address[1]} cannot be served ({error.strerror}); give --page another port or off"
        ) from None
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, name="page", daemon=True).start()
    player.page_url = f"http://{server.server_address[0]!s}:{server.server_address[1]}/"
    log.info("live page: %s", player.page_url)
    return server


PAGE = r"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>fingerflow</title>
<meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">
<style>
:root { --ink: #1c2733; --soft: #647384; --line: #dde3ea; --real: #1668b0; --gross: #8fb8dc; --red: #c0392b; }
* { box-sizing: border-box; }
body { margin: 0; font: 14px/1.4 system-ui, "Segoe UI", sans-serif; color: var(--ink); background: #f5f7f9; }
header { display: flex; gap: 14px; align-items: center; padding: 10px 20px; background: #fff; }
header { border-bottom: 1px solid var(--line); }
h1 { font-size: 17px; margin: 0; } h2 { display: flex; font-size: 13px; font-weight: 600; margin: 0 0 6px; }
#about { color: var(--soft); flex: 1; overflow: hidden; text-overflow: ellipsis; white-space: nowrap; }
#state { padding: 2px 10px; border-radius: 10px; background: #e3f2e6; color: #1d6b34; }
#state { white-space: nowrap; font-weight: 600; }
#state.gone { background: #fbe6e3; color: var(--red); }
button { font: inherit; padding: 5px 14px; border: 1px solid #b9c4cf; border-radius: 6px; background: #fff; }
button:hover { background: #eef3f8; cursor: pointer; }
main { max-width: 1340px; margin: 0 auto; padding: 14px 20px; display: grid; gap: 14px; }
main { grid-template-columns: repeat(2, minmax(0, 1fr)); }
section { background: #fff; border: 1px solid var(--line); border-radius: 8px; padding: 10px 12px; }
section.wide { grid-column: 1 / -1; }
canvas { display: block; width: 100%; border-radius: 3px; }
.trace { height: 130px; }
.legend { margin-left: auto; font-weight: 400; color: var(--soft); }
.legend i { display: inline-block; width: 10px; height: 10px; border-radius: 2px; margin: 0 4px 0 10px; }
.legend .bar { width: 90px; background: linear-gradient(90deg, #2166ac, #eee, #b2182b); }
dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(150px, 1fr)); gap: 4px 16px; margin: 0; }
dt { color: var(--soft); font-size: 12px; } dd { margin: 0; font-size: 18px; font-variant-numeric: tabular-nums; }
dd small { font-size: 12px; color: var(--soft); } dd.bad { color: var(--red); }
@media (max-width: 760px) { main { grid-template-columns: 1fr; } }
</style></head><body>
<header><h1>fingerflow</h1><span id="about"></span><span id="state">connecting</span>
<button id="restart" title="Choose points anew in the current frame">Restart points</button></header>
<main>
<section class="wide"><dl id="numbers"></dl></section>
<section><h2>Contact <span class="legend">
<i style="background:#ffa726"></i>real contact<i style="background:#00acc1"></i>ellipse</span></h2>
<canvas id="contact"></canvas></section>
<section><h2>Topography <span class="legend">
<i style="background:#ffd54f"></i>not in contact yet<i style="background:none"></i>divergence
&minus;<span id="low"></span><i class="bar"></i><span id="high"></span></span></h2>
<canvas id="topography"></canvas></section>
<section><h2>Contact area, mm&sup2; <span class="legend">
<i style="background:var(--gross)"></i>gross<i style="background:var(--real)"></i>real</span></h2>
<canvas id="areas" class="trace"></canvas></section>
<section><h2>Median divergence, %</h2><canvas id="divergence" class="trace"></canvas></section>
</main>
<script>
"use strict";
const $ = id => document.getElementById(id);
const TYPES = { uint8: Uint8Array, float32: Float32Array };
let range = 0.02;

function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const live = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let place = 4 + length + (-length & 3);
  live.data = {};
  for (const { name, type, shape } of live.arrays) {
    const values = new TYPES[type](buffer, place, shape.reduce((a, b) => a * b, 1));
    live.data[name] = { values, shape };
    place += values.byteLength + (-values.byteLength & 3);
  }
  return live;
}

function picture(canvas, view, mask) {
  const [height, width] = view.shape;
  const scale = 2;
  canvas.width = width * scale; canvas.height = height * scale;
  const image = new ImageData(width, height), out = image.data;
  for (let i = 0; i < view.values.length; i++) {
    const grey = view.values[i], touch = mask && mask.values[i];
    out[4 * i] = touch ? (grey + 255) / 2 : grey;
    out[4 * i + 1] = touch ? (grey + 167) / 2 : grey;
    out[4 * i + 2] = touch ? (grey + 38) / 2 : grey;
    out[4 * i + 3] = 255;
  }
  const small = new OffscreenCanvas(width, height);
  small.getContext("2d").putImageData(image, 0, 0);
  const context = canvas.getContext("2d");
  context.drawImage(small, 0, 0, width * scale, height * scale);
  return context;
}

function colour(value) {  // blue, light grey, red over -1 to 1
  const t = Math.max(-1, Math.min(1, value)), end = t < 0 ? [33, 102, 172] : [178, 24, 43], a = Math.abs(t);
  return `rgb(${end.map(c => Math.round(238 + (c - 238) * a)).join()})`;
}

function drawTopography(live) {
  const { topography_view, points, divergence } = live.data;
  const context = picture($("topography"), topography_view), k = 2 / live.every;
  const known = Array.from(divergence ? divergence.values : []).filter(Number.isFinite).map(Math.abs);
  known.sort((a, b) => a - b);
  if (known.length) range += 0.1 * (Math.max(0.01, known[Math.floor(0.95 * (known.length - 1))]) - range);
  $("low").textContent = $("high").textContent = (100 * range).toFixed(1) + " %";
  if (!points) return;
  for (let i = 0; i < points.shape[0]; i++) {
    const x = points.values[2 * i], y = points.values[2 * i + 1], d = divergence ? divergence.values[i] : NaN;
    if (!Number.isFinite(x)) continue;
    context.beginPath();
    context.arc((x + 0.5) * k, (y + 0.5) * k, 3, 0, 7);
    context.fillStyle = Number.isFinite(d) ? colour(d / range) : "#ffd54f";
    context.fill();
    context.lineWidth = 0.8; context.strokeStyle = "#0009"; context.stroke();
  }
}

function drawContact(live) {
  const { contact_view, real_contact_mask, center, semi_axes_mm } = live.data;
  const context = picture($("contact"), contact_view, real_contact_mask), k = 2 / live.every;
  const angle = live.scalars.angle;
  if (!center || !semi_axes_mm || angle == null || !Number.isFinite(center.values[0])) return;
  const [a, b] = Array.from(semi_axes_mm.values, v => v / live.mm_per_px * k);
  if (!(a > 0 && b > 0)) return;
  context.beginPath();
  context.ellipse((center.values[0] + 0.5) * k, (center.values[1] + 0.5) * k, a, b, angle, 0, 7);
  context.lineWidth = 3; context.strokeStyle = "#00acc1"; context.stroke();
}

function trace(canvas, rows, columns, scale) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = width * ratio; canvas.height = height * ratio;
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  context.font = "11px system-ui, sans-serif";
  const count = rows.shape[0], at = (i, c) => rows.values[4 * i + c] * scale;
  let low = 0, high = 0;
  for (const [c] of columns) for (let i = 0; i < count; i++) if (Number.isFinite(at(i, c))) {
    low = Math.min(low, at(i, c)); high = Math.max(high, at(i, c));
  }
  const span = high - low || 1, step = 10 ** Math.floor(Math.log10(span));
  const tick = step * (span / step > 5 ? 2 : span / step > 2 ? 1 : 0.5);
  const end = count ? rows.values[4 * (count - 1)] : 0, left = 40;
  const X = t => left + (width - left - 6) * (1 + (t - end) / 30);
  low = Math.floor(low / tick + 1e-6) * tick; high = Math.max(Math.ceil(high / tick - 1e-6) * tick, low + tick);
  const Y = v => 8 + (height - 30) * (1 - (v - low) / (high - low));
  context.textAlign = "right";
  for (let v = low; v <= high + tick / 2; v += tick) {
    context.strokeStyle = Math.abs(v) < tick / 2 ? "#aab4bf" : "#e8ecf0";
    context.beginPath(); context.moveTo(left, Y(v)); context.lineTo(width - 6, Y(v)); context.stroke();
    context.fillStyle = "#647384"; context.fillText(+v.toPrecision(4), left - 6, Y(v) + 4);
  }
  context.textAlign = "center";
  for (let s = 30; s >= 0; s -= 10) {
    context.fillText(s ? `\u2212${s} s` : "now", Math.min(X(end - s), width - 16), height - 6);
  }
  context.lineWidth = 1.8; context.lineJoin = "round";
  for (const [c, style] of columns) {
    context.beginPath(); context.strokeStyle = style;
    let open = false;
    for (let i = 0; i < count; i++) {
      const t = rows.values[4 * i], v = at(i, c);
      if (!Number.isFinite(v) || t < end - 30) { open = false; continue; }
      if (open) context.lineTo(X(t), Y(v)); else context.moveTo(X(t), Y(v));
      open = true;
    }
    context.stroke();
  }
}

const text = (value, digits) => value == null || !Number.isFinite(value) ? "\u2013" : value.toFixed(digits);

function numbers(live) {
  const s = live.scalars, ms = live.recent_ms;
  const cells = [
    ["Rate", text(live.rate, 1), "frames/s"],
    ["Latency, median", text(ms.median, 2), "ms"],
    ["Latency, 99 %", text(ms.p99, 2), "ms"],
    ["Worst so far", text(live.latency_ms.worst, 1), "ms"],
    ["Frames", live.processed, `of ${live.frames_in}`],
    ["Dropped", live.dropped, "", live.dropped > 0],
    ["Overruns", live.overruns, "", live.overruns > 0],
    ["Reconnects", live.reconnects, "", live.reconnects > 0],
    ["Points", live.tracked, `of ${live.found}`],
    ["Threshold", live.threshold == null ? "no contact yet" : text(100 * live.threshold, 1), "%"],
    ["Real area", text(s.real_area_mm2, 1), "mm\u00b2"],
    ["Gross area", text(s.gross_area_mm2, 1), "mm\u00b2"],
    ["Median divergence", text(s.median_divergence == null ? null : 100 * s.median_divergence, 2), "%"],
  ];
  $("numbers").innerHTML = cells.map(([name, value, unit, bad]) =>
    `<div><dt>${name}</dt><dd${bad ? ' class="bad"' : ""}>${value} <small>${unit}</small></dd></div>`).join("");
}

async function refresh() {
  try {
    const answer = await fetch("live");
    if (!answer.ok) throw new Error(answer.status);
    const live = unpack(await answer.arrayBuffer());
    $("about").textContent = `${live.bundle} \u00b7 ${live.provider} \u00b7 ${live.source}`;
    $("state").textContent = "running"; $("state").className = "";
    numbers(live);
    if (live.data.topography_view) { drawTopography(live); drawContact(live); }
    trace($("areas"), live.data.traces, [[2, "#8fb8dc"], [1, "#1668b0"]], 1);
    trace($("divergence"), live.data.traces, [[3, "#1668b0"]], 100);
  } catch (error) {
    console.info(error);
    $("state").textContent = "no stream"; $("state").className = "gone";
  }
  setTimeout(refresh, 66);
}
$("restart").onclick = () => fetch("restart", { method: "POST", headers: { "X-Fingerflow": "1" } });
refresh();
</script></body></html>
"""


# --- command line -----------------------------------------------------------------------------------------------------


def main(arguments: list[str] | None = None, prog: str | None = None) -> int:
    """0 at the source's end, 2 something the user can put right, 130 or 143 stopped by Ctrl-C or SIGTERM."""
    options = _parser(prog).parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname).1s %(message)s", stream=sys.stderr)
    # Python lets a thread compute for 5 ms before another gets its turn: as long as a frame may take in all.
    sys.setswitchinterval(5e-4)
    try:
        return _stream(options)
    except PlayerError as error:
        print(f"fingerflow: {error}", file=sys.stderr)
        return 2


def _stream(options: argparse.Namespace) -> int:
    bundle = load_bundle(options.bundle)
    played = _played(options, bundle)
    scene, name = played.scene, played.name
    for said in (warnings := contradictions(scene, bundle.recipe)):
        log.warning("%s", said)
    parallel = options.parallel_frames
    # Frames side by side share the threads inside operators, beside the one that each has itself.
    threads = options.threads or (max(1, (os.cpu_count() or 1) - parallel + 1) if parallel > 1 else 0)
    engine = Engine(bundle, options.provider, threads, options.spin)
    if parallel > 1 and engine.provider == "directml":
        raise PlayerError(
            "--parallel-frames: DirectML computes one frame at a time; leave it out, or add --provider cpu"
        )
    stepper = Stepper(engine, scene, played.glass, played.dark, parallel)
    stepper.warm_up()
    properties = engine.frame.get_modelmeta().custom_metadata_map
    layout = RecordLayout(stepper.outputs, scene.mm_per_px, json.loads(properties.get("fingerflow.units", "{}")))
    folder = options.output or scene.output or Path(f"results-{datetime.now():%Y%m%d-%H%M%S}")
    live = options.camera is not None
    every = options.policy == "every" if options.policy else not live
    settings = Settings(
        every=every,
        queue=options.queue if every else 1,
        rate=options.rate or (None if live else scene.frame_rate),
        first=played.first,
        frames=min((count for count in (options.frames, played.frames) if count is not None), default=None),
        give_up=options.give_up,
        page=options.page,
    )
    header = {
        "format": RESULTS_FORMAT,
        "started": datetime.now(UTC).isoformat(),
        "fingerflow": bundle.version,
        "recipe": bundle.recipe,
        "graph_sha256": bundle.hashes,
        "provider": PROVIDERS[engine.provider],
        "source": name,
        "policy": "every" if every else "latest",
        "mm_per_px": scene.mm_per_px,
        "topography_to_contact": scene.topography_to_contact.tolist(),
        "threshold": "measured" if stepper.measures else scene.threshold,
        "coordinates": properties.get("fingerflow.coordinates", ""),
        "warnings": warnings,
        "record_bytes": layout.dtype.itemsize,
        "fields": layout.fields,
    }
    log.info("results: %s, %.1f kB a frame", folder, layout.dtype.itemsize / 1e3)
    sink = Sink(folder, header)
    try:
        source = played.open_source(played.first)
    except PlayerError:
        raise
    except Exception as error:
        raise PlayerError(f"{name}: cannot be opened ({type(error).__name__}: {_first_line(error)})") from error
    player = Player(stepper, engine.provider, bundle, scene, source, played.open_source, sink, layout, settings, name)
    with _stopped_by_signals(player) as received:
        summary = player.run()
    text = json.dumps({**summary, "provider": PROVIDERS[engine.provider], "policy": header["policy"]}, indent=1)
    print(text)
    if options.json is not None:
        try:
            options.json.write_text(text + "\n", encoding="utf-8")
        except OSError as error:
            raise PlayerError(
                f"{options.json}: cannot be written ({error.strerror}); results are in {folder}"
            ) from None
    return 128 + received[0] if received else 0


class _Played(NamedTuple):
    """What is played: a source by name, which of its frames count, the contact views of empty glass and darkness."""

    scene: Scene
    name: str
    open_source: OpenSource
    glass: Array
    dark: Array
    first: int = 0
    frames: int | None = None


def _played(options: argparse.Namespace, bundle: Bundle) -> _Played:
    if options.camera and options.source:
        raise PlayerError(f"--camera {options.camera} and --source {options.source} exclude each other; keep one")
    shape = None if options.shape is None else (options.shape[0], options.shape[1])
    synthetic = options.source == "synthetic"
    path = options.scene
    if path is None and not synthetic:
        path = options.bundle / "scene.toml"
    scene = side_by_side(bundle.height, bundle.width) if path is None else load_scene(path)
    check_scene(scene, bundle)
    black = np.zeros((bundle.height, bundle.width), np.float32)
    if synthetic:
        drawn = Synthetic(scene, bundle.dtype, bundle.bit_depth)
        return _Played(scene, "synthetic", drawn.from_frame, scene.contact.crop(drawn.background), black)
    if scene.background is None:
        raise PlayerError(
            f"{path}: background.frames is missing; give a file of the empty glass, of one or more frames"
        )
    glass, dark = (
        black if file is None else mean_view(file, scene.contact, bundle, shape, options.dtype)
        for file in (scene.background, scene.dark)
    )
    if options.camera:
        return _Played(scene, options.camera, lambda _: open_camera(options.camera), glass, dark)
    file = Path(options.source) if options.source else scene.frames
    if file is None:
        raise PlayerError("no source: give --source synthetic, --source FILE or --camera MODULE:FACTORY")
    first, frames = 0, None
    if file.resolve() == scene.frames:  # the range is that of the scene's own recording
        first = scene.first_frame
        frames = None if scene.last_frame is None else scene.last_frame + 1 - first
    return _Played(
        scene, str(file), lambda number: open_recording(file, shape, options.dtype, number), glass, dark, first, frames
    )


def check_scene(scene: Scene, bundle: Bundle) -> None:
    """Raises PlayerError where the views are not of the bundle's size, or the region leaves the view."""
    size = (bundle.height, bundle.width)
    for name, view in (("contact", scene.contact), ("topography", scene.topography)):
        if view.shape != size:
            raise PlayerError(
                f"views.{name} of the scene is {view.shape[0]} x {view.shape[1]} px, the bundle was exported for "
                f"{size[0]} x {size[1]}; correct rows and columns, or export one with views of that size"
            )
    if scene.region and (scene.region.rows[1] > size[0] or scene.region.columns[1] > size[1]):
        raise PlayerError(f"stream.region of the scene ends beyond the topography view of {size[0]} x {size[1]} px")


_PLAYED = {  # what a stream does, whatever a scene says, because later frames are not known or graphs are fixed
    "contact.threshold": "reference_frame",
    "tracking.direction": "forward",
    "tracking.search_px": 0,
    "tracking.template": "keyframe",
    "fields.strain": "green_lagrange",
}


def contradictions(scene: Scene, recipe: Mapping[str, Any]) -> list[str]:
    """One sentence for each setting of the scene that the recipe has decided otherwise."""
    decided = {f"{table}.{key}": value for table, keys in recipe.items() for key, value in keys.items()} | _PLAYED
    return [
        f"{name} of the scene is {value!r}; the bundle plays with {decided[name]!r}"
        for name, value in scene.asked.items()
        if name in decided and value != decided[name] and not (name == "contact.threshold" and scene.threshold)
    ]


@contextlib.contextmanager
def _stopped_by_signals(player: Player) -> Iterator[list[int]]:
    """The first Ctrl-C or SIGTERM ends the stream cleanly; a second one is Python's own. Gives what was received."""
    received: list[int] = []
    before: dict[int, Any] = {}

    def stop(number: int, _: Any) -> None:
        received.append(number)
        for each, handler in before.items():
            signal.signal(each, handler)
        player.stop()

    if threading.current_thread() is threading.main_thread():
        before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _parser(prog: str | None) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog, description="Contact area, points and divergence of a live stream.")
    here = Path(__file__).resolve().parent
    add = parser.add_argument
    add("bundle", nargs="?", type=Path, default=here, help="folder of the exported bundle; default: this file's")
    add("--source", help="a .npy, raw or video file, or `synthetic`; default: recording.frames of the scene")
    add(
        "--camera",
        metavar="MODULE:FACTORY",
        help="factory() gives a callable that returns the next frame, None at the end",
    )
    add("--scene", type=Path, help="scene file; default: scene.toml of the bundle, the synthetic source needs none")
    add("--shape", type=_count, nargs=2, metavar=("HEIGHT", "WIDTH"), help="of the frames of a raw file")
    add("--dtype", default="uint8", help="of the frames of a raw file, such as '<u2'; default uint8")
    add("--rate", type=_positive, help="play a recording at so many frames a second, as a camera would give them")
    add("--frames", type=_count, help="end after so many frames")
    add("--policy", choices=("every", "latest"), help="every frame (default for files), or the newest (for cameras)")
    add("--queue", type=_count, default=Settings.queue, help="frames that wait at most under the policy `every`")
    add(
        "--provider",
        choices=PROVIDERS,
        help="execution provider; default: the first of onnxruntime's that works, in this order. `compiled` is for "
        "computers with the package fingerflow: six times as fast as cpu",
    )
    add("--threads", type=_count, default=0, help="threads inside an operator; default one a core")
    add("--parallel-frames", type=_count, default=1, metavar="N", help="compute N frames side by side, on N cores")
    add("--no-spin", dest="spin", action="store_false", help="let waiting threads sleep: slower, but cores are free")
    add("--output", type=Path, help="new folder of the results; default stream.output of the scene, or results-TIME")
    add("--json", type=Path, metavar="FILE", help="write the summary to FILE too")
    add("--page", type=_address, default=("127.0.0.1", 8765), metavar="[HOST:]PORT", help="of the live page, or `off`")
    add("--give-up", type=_positive, default=Settings.give_up, metavar="S", help="end after so long without a frame")
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value


def _address(text: str) -> tuple[str, int] | None:
    if text == "off":
        return None
    host, _, port = text.rpartition(":")
    if not port.isdigit() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is no [HOST:]PORT and not `off`")
    return host or "127.0.0.1", int(port)


if __name__ == "__main__":
    sys.exit(main())
