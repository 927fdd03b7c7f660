"""Synthetic contact that skin passes through, as under a rolling finger: skin enters on one side in every frame."""

from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from fingerflow.synthetic import Slide, write_recording
from fingerflow.synthetic.motion import Ellipse


@dataclass(frozen=True, kw_only=True)
class Rolling(Slide):
    """Recording of skin that passes a contact at rest from the trigger on, stretched by `stretch` per mm along x.

    material = position - (s + stretch s a) along x, with s = travel x progress and a the distance along x from the
    centre of the contact. The map is linear in position, so every gradient is exact: F = 1 / (1 - stretch s) along x.
    """

    stretch: float = 0.03

    def material(self, x: Tensor, y: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        way = self.travel * progress * (1 + self.stretch * (x - self.contact_centre[0]))
        return x - way, y - 0 * way

    def depth(self, x: Tensor, y: Tensor, progress: Tensor) -> Tensor:
        return 1 - self.ellipse(0).radius(x, y) + 0 * progress

    def ellipse(self, progress: float) -> Ellipse:
        return Ellipse(self.contact_centre, self.semi_axes, self.tilt)


def write_rolling(folder: Path, trial: Rolling) -> Path:
    """Write a recording without the region of a stream, so that `process` itself finds the skin that will touch; return
    its folder.
    """
    write_recording(folder, trial)
    lines = (folder / "scene.toml").read_text(encoding="utf-8").splitlines()
    text = "\n".join(one for one in lines if not one.startswith("region = "))
    (folder / "scene.toml").write_text(text, encoding="utf-8")
    return folder
