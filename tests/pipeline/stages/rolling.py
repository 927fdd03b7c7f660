"""Synthetic contact that skin passes through, as under a rolling finger: skin enters on one side in every frame."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from torch import Tensor

from fingerflow.synthetic import Slide, write_recording
from fingerflow.synthetic.motion import Ellipse, SlideMotion


@dataclass(frozen=True)
class RollingMotion(SlideMotion):
    """Motion of skin that passes a contact at rest, stretched by `stretch` per mm along its path.

    material = position - direction (s + stretch s a), with s = travel x progress and a the distance along the direction
    from the centre of the contact. The map is linear in position, so every gradient is exact: F = 1 / (1 - stretch s)
    along the direction.
    """

    stretch: float = 0.03

    def material(self, x: Tensor, y: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        right, down = self.direction
        along = (x - self.contact.centre[0]) * right + (y - self.contact.centre[1]) * down
        way = self.travel * progress * (1 + self.stretch * along)
        return x - way * right, y - way * down

    def depth(self, x: Tensor, y: Tensor, progress: Tensor) -> Tensor:
        return 1 - self.contact.radius(x, y) + 0 * progress

    def ellipse(self, progress: float) -> Ellipse:
        return self.contact


@dataclass(frozen=True, kw_only=True)
class Rolling(Slide):
    """Recording of `RollingMotion` from the trigger on."""

    @cached_property
    def motion(self) -> RollingMotion:
        return RollingMotion(Ellipse(self.contact_centre, self.semi_axes, self.tilt), (1.0, 0.0), 0.0, self.travel, 1.0)


def write_rolling(folder: Path, trial: Rolling) -> Path:
    """Write a recording without the region of a stream, so that `process` itself finds the skin that will touch; return
    its folder.
    """
    write_recording(folder, trial)
    lines = (folder / "scene.toml").read_text(encoding="utf-8").splitlines()
    text = "\n".join(one for one in lines if not one.startswith("region = "))
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    return folder
