"""False alarms of the slip flag: presses, flicker of the light and rolling fingers, played as streams.

The number is the share of the frames in which the flag is up. In none of these does skin slip: the bound is 1 % of the
frames. Many more rolls are computed from true positions with noise, without pictures. Trials of partial slip follow,
where the flag must come: the number is the share of the contact that has slipped when it does.
"""

import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fingerflow.engines.engine import Array
from fingerflow.synthetic import Bump, ChainPress, PartialSlip, Press, SyntheticScene
from fingerflow.synthetic.motion import Ellipse
from fingerflow.tracker.slip_flag import SlipFlag
from tests.silent.case import Case
from tests.silent.case import records_of as played
from tests.small_trials import HEIGHT, WIDTH, recipe_of_trials, write_library_bundle, write_scene_of_bundle

MOST_FALSE = 0.01
FLICKER = 0.1
_ROLLS, _NOISE_PX = 120, 0.03
_PRESSED = 0.3  # share of a roll after which the press ends and the rolling begins
SIZE: dict[str, Any] = {"frame_shape": (HEIGHT, 2 * WIDTH), "finger": (3.2, 2.7)}


def _rolled(progress: Tensor) -> Tensor:
    """Return the fraction of the rolling distance covered at `progress` (0 to 1), with a smooth start and end."""
    return 0.5 - 0.5 * torch.cos(math.pi * ((progress - _PRESSED) / (1 - _PRESSED)).clamp(0, 1))


@dataclass(frozen=True, kw_only=True)
class Roll(Press):
    """Synthetic roll of a fingertip: a press, after which the contact moves by `way` mm, while skin that touches stays
    where it touched, but for `shear` mm, by which the whole finger shifts meanwhile.
    """

    way: tuple[float, float] = (2.2, 0.5)
    shear: tuple[float, float] = (0.0, 0.0)
    bumps: tuple[Bump, ...] = ()

    entry_steps = 64

    @cached_property
    def contact(self) -> Ellipse:
        (x, y), contact = self.contact_centre, super().contact
        return Ellipse((x - self.way[0] / 2, y - self.way[1] / 2), contact.semi_axes, contact.angle)

    def material(self, x: Tensor, y: Tensor, progress: Tensor) -> tuple[Tensor, Tensor]:
        pressed, rolled = (progress / _PRESSED).clamp(max=1), _rolled(progress)
        return super().material(x - rolled * self.shear[0], y - rolled * self.shear[1], pressed)

    def depth(self, x: Tensor, y: Tensor, progress: Tensor) -> Tensor:
        pressed, rolled = (progress / _PRESSED).clamp(max=1), _rolled(progress)
        return super().depth(x - rolled * self.way[0], y - rolled * self.way[1], pressed)

    def ellipse(self, progress: float) -> Ellipse | None:
        pressed, rolled = super().ellipse(min(progress / _PRESSED, 1)), float(_rolled(torch.tensor(progress)))
        if pressed is None:
            return None
        x, y = pressed.centre
        return Ellipse((x + rolled * self.way[0], y + rolled * self.way[1]), pressed.semi_axes, pressed.angle)

    def progress(self, time: Any) -> Any:
        return np.clip(time / self.times[-1], 0, 1)

    def normal_force(self, time: Any) -> Any:
        return self.force * np.clip(self.progress(time) / _PRESSED, 0, 1) ** 4


def quiet_scenes(frames: int) -> dict[str, SyntheticScene]:
    """Return scenes of so many frames in two seconds in which no skin slips."""
    time: dict[str, Any] = {"n_frames": frames, "frame_rate": frames / 2, "frames_before_trigger": 6, **SIZE}
    large, small = (2.3, 1.9), (1.6, 1.5)
    return {
        "press that shifts": Press(shift=(0.2, -0.1), drag=0.08, semi_axes=large, **time),
        "press of slippery skin": ChainPress(friction=0.1, elements=501, **time),
        "press of soft skin": ChainPress(friction=1.0, parameters="fitted", elements=501, **time),
        "roll": Roll(semi_axes=small, **time),
        "roll and shear": Roll(semi_axes=small, way=(-2.0, 1.0), shear=(-0.15, 0.1), **time),
    }


def records_of(scene: SyntheticScene, flicker: float, folder: Path) -> Array:
    """Return the records of a stream of a scene whose light changes by the share `flicker` from frame to frame."""
    file = write_scene_of_bundle(folder / "trial", scene)
    frames = np.load(folder / "trial" / "frames.npy")
    light = 1 + flicker * np.sin(np.arange(len(frames)))
    np.save(folder / "trial" / "frames.npy", np.clip(np.rint(frames * light[:, None, None]), 0, 255).astype("u1"))
    return played(write_library_bundle(folder / "bundle", recipe_of_trials()), file)


def flags_of(scene: SyntheticScene, seed: int) -> Array:
    """Return the slip flag (frames,) of a scene without pictures: of 450 points at their true positions with noise."""
    truth, generator, flag = scene.truth, np.random.default_rng(seed), SlipFlag()
    material = generator.uniform(-3.6, 3.6, (450, 2)) + scene.contact_centre
    flags = np.zeros(scene.n_frames, dtype=bool)
    for frame in range(scene.n_frames):
        position, ellipse = truth.positions(material, frame), truth.ellipse(frame)
        points = truth.topography_pixels(position) + generator.normal(0, _NOISE_PX, position.shape)
        depth = torch.full((len(position),), -1.0)
        if ellipse is not None:
            depth = ellipse.distance(*torch.from_numpy(position).unbind(-1))
        flag.update(points, np.full(len(points), _NOISE_PX), (depth > 0).numpy())
        flags[frame] = flag.slipping
    return flags


def random_rolls(count: int) -> Iterator[Roll]:
    """Yield rolls of any direction over 0.5 to 3.5 mm, every other one with shear, after presses of any kind."""
    generator = np.random.default_rng(5)
    for number in range(count):
        length, angle = generator.uniform(0.5, 3.5), generator.uniform(0, 2 * math.pi)
        gradient = generator.normal(0, 0.03, (2, 2))
        yield Roll(
            semi_axes=(generator.uniform(1.2, 2.2), generator.uniform(1.2, 2.2)),
            way=(length * math.cos(angle), length * math.sin(angle)),
            shear=tuple(generator.normal(0, 0.1, 2) * (number % 2)),
            shift=tuple(generator.normal(0, 0.15, 2)),
            gradient=(tuple(gradient[0]), tuple(gradient[1])),
            **{"n_frames": 120, "frame_rate": 60.0, "frames_before_trigger": 6, **SIZE},
        )


def cases(few: bool = False) -> Iterator[Case]:
    """Yield the scenes without slip, in steady and in flickering light, then trials of partial slip."""
    for name, scene in quiet_scenes(100 if few else 200).items():
        for flicker in (0.0, FLICKER):
            with tempfile.TemporaryDirectory() as folder:
                records = records_of(scene, flicker, Path(folder))
            up = records["slip_flag"].astype(bool)
            light = f"light changes by {flicker:.0%}" if flicker else "steady light"
            verdict = "right" if up.mean() < MOST_FALSE else "false alarm"
            yield Case(f"{name}, {light}", f"{up.mean():.2%} of the frames", "0", f"{len(up)} frames", verdict)
    flags = [flags_of(roll, seed) for seed, roll in enumerate(random_rolls(20 if few else _ROLLS))]
    share, raised = np.mean(flags), sum(one.any() for one in flags)
    verdict = "right" if share < MOST_FALSE else "false alarm"
    name = f"{_ROLLS} random rolls, positions alone, steady light"
    yield Case(name, f"{share:.2%} of the frames", "0", f"in {raised} of the rolls", verdict)
    for seed in range(1 if few else 3):
        slip = PartialSlip(
            n_frames=90, frame_rate=60.0, frames_before_trigger=20, semi_axes=(2.3, 1.9), creep=0.45,
            travel=0.8, direction=0.1 + 2.1 * seed, **SIZE,
        )  # fmt: skip
        with tempfile.TemporaryDirectory() as folder:
            up = records_of(slip, 0.0, Path(folder))["slip_flag"].astype(bool)
        first = int(up.argmax())
        slipped = 1 - slip.stuck_share(first) if up.any() else math.nan
        right = up.any() and 0.02 < slipped < 0.15 and not up[:20].any()
        said = f"up from frame {first} of {len(up)} on" if up.any() else "never up"
        yield Case(f"partial slip {seed}", f"{slipped:.0%} of the contact", "0", said, "right" if right else "late")
