"""Simulated GenTL producer: takes the place of the module `harvesters.core`, and needs NumPy alone."""

from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np


class Harvester:
    """Simulated `Harvester` of the package harvesters: one camera whose buffer is used again for every frame.

    Attributes:
        serials: serial numbers of its cameras.
        kind: pixel format of the frames.
        events: what was called, and the features that were set.
        frames: pictures (H, W) with their time stamps in ns or None; None in place of a picture is no frame.
    """

    serials: ClassVar = ["17"]
    kind: ClassVar = "Mono8"
    events: ClassVar[list[str]] = []
    frames: ClassVar[list[Any]] = []

    def __init__(self) -> None:
        self.device_info_list: list[Any] = []
        nodes = {name: SimpleNamespace(from_string=self._take(name)) for name in ("ExposureTime", "PixelFormat")}
        self.remote_device = SimpleNamespace(node_map=SimpleNamespace(**nodes))
        self._buffer = np.zeros(0, np.uint8)
        self._left = iter(self.frames)

    def _take(self, name: str) -> Any:
        def take(value: str) -> None:
            if not value:
                raise ValueError("no value")
            self.events.append(f"{name}={value}")

        return take

    def add_file(self, path: str) -> None:
        self.events.append(Path(path).name)

    def update(self) -> None:
        self.device_info_list = [SimpleNamespace(serial_number=one) for one in self.serials]

    def create(self, asked: dict[str, str]) -> "Harvester":
        self.events.append(f"create {asked['serial_number']}")
        return self

    def start(self) -> None:
        self.events.append("start")

    @contextmanager
    def fetch(self, timeout: float) -> Any:
        picture, stamp = next(self._left)
        if picture is None:
            raise TimeoutError("no buffer")
        self._buffer = self._buffer if self._buffer.size == picture.size else np.empty(picture.size, picture.dtype)
        self._buffer[:] = picture.ravel()
        height, width = picture.shape
        part = SimpleNamespace(data=self._buffer, height=height, width=width, data_format=self.kind)
        buffer = SimpleNamespace(payload=SimpleNamespace(components=[part]))
        if stamp is not None:
            buffer.timestamp_ns = stamp
        yield buffer
        self._buffer[:] = 0  # the camera uses its buffer again

    def stop(self) -> None:
        self.events.append("stop")

    def destroy(self) -> None:
        self.events.append("destroy")

    def reset(self) -> None:
        self.events.append("reset")
