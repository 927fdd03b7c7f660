"""Simulated experiment of Terekhov & Hayward 2011: ten slides, recorded, and measured as a study."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from fingerflow.models.partial_slip.verdict import Outcome
from fingerflow.report.slip_trials import SlipTrial
from fingerflow.results.atomic_write import write_text
from fingerflow.results.result import load_result
from fingerflow.schema.scene import Scene
from fingerflow.study.init import init_study
from fingerflow.study.manifest import load_manifest
from fingerflow.study.run_study import run_study
from fingerflow.study.table import write_tables
from fingerflow.study.trial_files import read_row
from fingerflow.synthetic import Camera, LinearSlip, RidgeTexture, rebuild_scene, write_recording

ABRUPT, FADING, UNSTEADY = "abrupt", "fading", "unsteady"
#: Verdict that each set of slides should get.
EXPECTED: dict[str, Outcome] = {ABRUPT: "vanishes abruptly", FADING: "diminishes", UNSTEADY: "inconclusive"}

# Pairs of the d^2 at which the collapse begins and its duration (s). The ranges and durations are printed; their
# pairing is not.
_COLLAPSES = ((0.34, 0.13), (0.26, 0.15), (0.17, 0.28), (0.10, 0.31))
_FADE_S = 0.02  # s, duration over which a faded area vanishes: the time between the largest load and the slide
# Relative swing of the tangential force; with more than 5 % the force is unsteady.
_SWINGS = {ABRUPT: 0.01, FADING: 0.01, UNSTEADY: 0.2}
# Exponent of the decay of fading areas. The paper saw less than 0.05 of the area at 5 % below the largest load. A
# straight line has exactly this, so these areas lie below it.
_BEND = 1.3
_RATE_HZ, _SECONDS = 60.0, 2.4
_PIXEL_MM = 0.04  # mm, pixel size of the paper


@dataclass(frozen=True)
class JudgedSlide:
    """Simulated slide of a finger with its measurement: set ("abrupt" or "fading" loss of the stuck area, or "unsteady"
    tangential force), true slip, measured trial, and scene.
    """

    kind: str
    truth: LinearSlip
    trial: SlipTrial
    scene: Scene


@dataclass(frozen=True)
class Slides:
    """Measured slides of the simulated experiment, and messages on slides that could not be measured."""

    slides: tuple[JudgedSlide, ...]
    failed: tuple[str, ...] = ()

    def of(self, kind: str) -> list[JudgedSlide]:
        """Return the measured slides of one set: "abrupt" or "fading" loss of the stuck area, or "unsteady" tangential
        force.
        """
        return [one for one in self.slides if one.kind == kind]


def design_slides() -> dict[str, LinearSlip]:
    """Return the ten simulated slides by folder name.

    The stick region collapses in four of them and fades in four; in two the tangential force is unsteady. A folder is
    participant and trial; friction, forces, sizes and skin differ from slide to slide. The stuck area of those that
    collapse falls in a straight line with the load, as the paper saw no parabolic decay.
    """
    sets = [*((ABRUPT, *pair) for pair in _COLLAPSES), *((FADING, 0.0, _FADE_S),) * 4, *((UNSTEADY, 0.2, 0.2),) * 2]
    return {
        f"p{1 + place % 5:02d}/trial{1 + place:02d}": _slide(place, kind, last, collapse)
        for place, (kind, last, collapse) in enumerate(sets)
    }


def kind_of(slide: LinearSlip) -> str:
    """Return the set to which a simulated slide belongs: "abrupt" or "fading" loss of the stuck area, or "unsteady"
    tangential force.
    """
    return UNSTEADY if slide.swing >= _SWINGS[UNSTEADY] else ABRUPT if slide.last > 0 else FADING


def record_and_measure(folder: Path) -> Slides:
    """Simulate the recordings of all slides, process them as a study, and return the slides; existing files are kept.

    Raises FingerflowError if a file cannot be written.
    """
    recordings = folder / "recordings"
    slides = design_slides()
    for name, slide in tqdm(slides.items(), desc="slides"):
        if not (recordings / name).exists():
            write_recording(recordings / name, slide, progress=False)
    if not (recordings / "study.toml").exists():
        _write_sets(recordings / "sets.csv", slides)
        init_study(recordings, recordings / "sets.csv")
    manifest = load_manifest(recordings)
    run_study(manifest)
    write_tables(manifest)
    judged, failed = [], []
    for entry in manifest.trials:
        stored, home = read_row(manifest.results / entry.name), recordings / f"p{entry.participant}/trial{entry.trial}"
        if stored is None or stored.result is None:
            failed.append(f"{entry.name}: {'not run' if stored is None else stored.reason}")
            continue
        result = load_result(manifest.results / entry.name / stored.result)
        truth = rebuild_scene(home)
        assert isinstance(truth, LinearSlip)
        judged.append(
            JudgedSlide(entry.condition, truth, SlipTrial.read(result, entry.name), manifest.build_scene(entry))
        )
    return Slides(tuple(judged), tuple(failed))


def _slide(number: int, kind: str, last: float, collapse: float) -> LinearSlip:
    draw = np.random.default_rng([number, 0x511D])
    static = draw.uniform(0.6, 1.2)
    length = draw.uniform(4.3, 5.0)
    return LinearSlip(
        n_frames=round(_RATE_HZ * _SECONDS),
        frame_rate=_RATE_HZ,
        frames_before_trigger=6,
        frame_shape=(272, 640),
        mm_per_px=_PIXEL_MM,
        finger=(1.3 * length, 1.2 * length),
        semi_axes=(length, length * draw.uniform(0.8, 0.92)),
        tilt=draw.uniform(-0.3, 0.3),
        direction=draw.uniform(-0.4, 0.4),
        creep=length * draw.uniform(0.18, 0.28),
        travel=draw.uniform(0.8, 1.2),
        full_slip=0.75,
        collapse=collapse,
        last=last,
        bend=_BEND if kind == FADING else 1.0,
        static_friction=static,
        kinetic_friction=static * draw.uniform(0.6, 0.85),
        swing=_SWINGS[kind],
        force=draw.uniform(1.0, 3.0),
        force_noise=0.01,
        camera=Camera(noise=draw.uniform(1.0, 2.0), seed=number),
        texture=RidgeTexture(centre=(draw.uniform(-0.8, 0.8), draw.uniform(-1.2, 0.0))),
    )


def _write_sets(path: Path, slides: dict[str, LinearSlip]) -> None:
    """Write the table that `study init` reads: participant, trial, empty answer, and the slide's set as condition."""
    lines = ["participant,trial,answer,condition"]
    for name, slide in slides.items():
        participant, trial = name.split("/")
        lines.append(f"{participant.removeprefix('p')},{trial.removeprefix('trial')},,{kind_of(slide)}")
    write_text(path, "\n".join(lines) + "\n")
