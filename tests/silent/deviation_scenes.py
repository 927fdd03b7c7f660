"""Presses and slides with the skin of real prints, whose stated standard deviations are compared with true errors.

They differ in print, noise, frame rate, deformation, size of the contact and way.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import TypeVar

from bench.prints import DPI, FINGERS
from bench.suites.stated import strained
from fingerflow.synthetic import PartialSlip, Press, Slide, scene_of_print
from fingerflow.synthetic.scenes import SyntheticScene

_SMALL = {"frame_shape": (418, 1044), "finger": (6.2, 5.2), "frames_before_trigger": 3}
PRESS = replace(Press(**_SMALL), semi_axes=(4.4, 3.6))
SLIDE = replace(Slide(**_SMALL), semi_axes=(4.0, 3.4), travel=1.2)
SLIP = replace(PartialSlip(**_SMALL), semi_axes=(4.0, 3.4), travel=1.2, creep=0.8)
# Print, noise in grey levels, frames, and of presses the factor of the deformation and semi-axes in mm.
PRESSES = (
    ("101_1", 1.0, 60, 1.0, (4.4, 3.6)),
    ("101_2", 2.0, 60, 0.5, (4.4, 3.6)),
    ("101_3", 3.0, 90, 1.0, (4.4, 3.6)),
    ("101_4", 2.0, 60, 1.0, (4.4, 3.6)),
    ("104_1", 2.0, 60, 2.0, (4.4, 3.6)),
    ("104_2", 4.0, 60, 1.0, (4.4, 3.6)),
    ("101_4", 1.0, 90, 2.0, (4.4, 3.6)),
    ("104_2", 2.0, 90, 0.5, (3.6, 4.4)),
    ("101_2", 2.0, 40, 1.0, (3.4, 2.8)),
    ("101_1", 4.0, 60, 2.0, (4.4, 3.6)),
    ("104_1", 1.0, 40, 0.5, (3.4, 3.4)),
    ("101_3", 2.0, 60, 1.5, (4.0, 3.8)),
)
# Print, noise, frames, creep in mm, direction in rad.
SLIDES = (
    ("101_1", 2.0, 60, 0.8, 0.1),
    ("101_3", 2.0, 90, 0.4, 1.2),
    ("101_4", 1.0, 60, 0.6, -2.5),
    ("104_1", 2.0, 90, 0.8, 3.0),
    ("104_2", 3.0, 90, 0.5, -1.0),
)
# Print, noise, frames, ratio of kinetic to static friction.
SLIPS = (("101_2", 2.0, 60, 0.5), ("101_4", 1.0, 60, 0.7), ("104_1", 3.0, 90, 0.5))

Kind = TypeVar("Kind", bound=SyntheticScene)


def scenes() -> Iterator[tuple[str, SyntheticScene]]:
    """Yield the twenty scenes with their names."""
    seed = 300
    for number, (name, noise, frames, factor, axes) in enumerate(PRESSES):
        press = _of_print(strained(PRESS, factor), name, noise, frames, seed + number)
        yield f"press {number} of {name}", replace(press, semi_axes=axes)
    for number, (name, noise, frames, creep, direction) in enumerate(SLIDES):
        slide = _of_print(SLIDE, name, noise, frames, seed + 50 + number)
        yield f"slide {number} of {name}", replace(slide, creep=creep, direction=direction)
    for number, (name, noise, frames, ratio) in enumerate(SLIPS):
        slip = _of_print(SLIP, name, noise, frames, seed + 80 + number)
        yield f"partial slip {number} of {name}", replace(slip, kinetic_friction=ratio * slip.static_friction)


def _of_print(scene: Kind, name: str, noise: float, frames: int, seed: int) -> Kind:
    """Return a scene of a second with the skin of a print, and a camera's noise in grey levels."""
    texture = scene_of_print(type(scene), FINGERS / f"{name}.tif", DPI).texture
    camera = replace(scene.camera, noise=noise, seed=seed)
    return replace(scene, texture=texture, camera=camera, n_frames=frames, frame_rate=float(frames))
