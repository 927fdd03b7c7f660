"""Source of frames from a GenICam camera by its maker's GenTL producer; needs the package harvesters."""

import math
from pathlib import Path
from typing import Any

from fingerflow.engines.engine import Array
from fingerflow.errors import PlayerError
from fingerflow.player.named_objects import load_library
from fingerflow.player.sources.source import Source

ADDRESS = "genicam:PRODUCER.cti[,serial=NUMBER][,FEATURE=VALUE]..."
_SILENT = 5.0  # s without a frame after which the camera is opened again


class GenICamCamera:
    """Frame source that is the first camera found by a GenTL producer (a maker's driver file), or that with a serial
    number; features of the camera are set before it starts.

    Frames are Mono8 to Mono16. The time stamp is the camera's; NaN where its producer passes none on.
    """

    live = True

    def __init__(self, producer: str, serial: str | None, features: dict[str, str]) -> None:
        self._harvester = load_library("harvesters.core", "harvesters").Harvester()
        if not Path(producer).is_file():
            raise PlayerError(f"{producer}: is no file; give the .cti file of the camera's maker")
        self.stamp = math.nan
        self._camera: Any = None
        try:
            self._harvester.add_file(producer)
            self._harvester.update()
            serials = [device.serial_number for device in self._harvester.device_info_list]
            if not serials or (serial or serials[0]) not in serials:
                raise PlayerError(f"{producer} finds the cameras {', '.join(serials) or 'none'}; is it on?")
            self._camera = self._harvester.create({"serial_number": serial or serials[0]})
            nodes = self._camera.remote_device.node_map
            for name, value in features.items():
                if not hasattr(nodes, name):
                    raise PlayerError(f"the camera has no feature {name!r}")
                try:
                    getattr(nodes, name).from_string(value)
                except Exception as error:
                    raise PlayerError(f"the camera does not take {name}={value} ({error})") from None
            self._camera.start()
        except BaseException:
            self.close()
            raise

    def read(self) -> Array:
        """Return the next frame (H, W); raise an error where none comes within five seconds."""
        with self._camera.fetch(timeout=_SILENT) as buffer:
            picture = buffer.payload.components[0]
            if not picture.data_format.startswith("Mono"):
                remedy = "set its PixelFormat to Mono8, or for more bits to Mono10, Mono12 or Mono16"
                raise PlayerError(f"the camera gives {picture.data_format}: {remedy}")
            try:
                self.stamp = buffer.timestamp_ns / 1e9
            except Exception:  # each producer has its own exception
                self.stamp = math.nan
            # Copy the frame: the camera writes into the buffer again once it is given back.
            return picture.data.reshape(picture.height, picture.width).copy()

    def close(self) -> None:
        """Stop and release the camera, and reset its GenTL producer."""
        if self._camera is not None:
            self._camera.stop()
            self._camera.destroy()
        self._harvester.reset()


def open_address(address: str) -> Source:
    """Open the GenICam camera of an address PRODUCER.cti[,serial=NUMBER][,FEATURE=VALUE]..., and return it as a source
    of frames.
    """
    producer, *settings = address.split(",")
    pairs = dict(setting.partition("=")[::2] for setting in settings)
    return GenICamCamera(producer, pairs.pop("serial", None), pairs)
