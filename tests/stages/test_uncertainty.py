"""Stated standard deviations beside the errors of simulated tracks: z, RMS of the error over that of the statement.

Points move with a uniform deformation while the contact grows over them; each is followed with noise, which it shares
with others as their windows overlap, and comes into contact where the border is, to a frame and to what the border is
uncertain by. What the same estimators say of the
exact positions and times is the truth, so that smoothing is no part of the error.
"""

from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from fingerflow.stages import deformation
from fingerflow.stages.contact import ContactSeries
from fingerflow.stages.deformation import Displacement, displace, fields, strains
from fingerflow.stages.inputs import Inputs, as_it_is
from fingerflow.stages.tracking import TrackSeries

FRAMES, MM_PER_PX, SPEED = 36, 0.03, 0.1  # of the border, mm a frame
WINDOW_PX, COPIES = 25, 40


class Motion(NamedTuple):
    """Per frame: shift in mm and gradient; noise of a position, px."""

    shift: tuple[float, float]
    gradient: tuple[tuple[float, float], tuple[float, float]]
    noise: float


MOTIONS = {
    "noise": Motion((0.0, 0.0), ((0.0004, 0.0001), (-0.0002, 0.0003)), 0.05),
    "onset": Motion((0.01, 0.004), ((0.001, 0.0), (0.0, 0.001)), 0.02),
}


def inputs(template: str = "keyframe") -> Inputs:
    scene = SimpleNamespace(
        fields=SimpleNamespace(
            gauge_length_mm=1.6, strain="green_lagrange", young_modulus_mpa=1.0, poisson_ratio=0.4, depth_mm=2.0
        ),
        tracking=SimpleNamespace(template=template, window_px=WINDOW_PX),
    )
    return cast(
        Inputs,
        SimpleNamespace(
            scene=scene,
            mm_per_px=MM_PER_PX,
            topography_to_contact=np.eye(2, 3),
            device=torch.device("cpu"),
            engine=as_it_is,
        ),
    )


def contact() -> ContactSeries:
    size = 0.5 + SPEED * np.arange(FRAMES)
    nothing = np.zeros(FRAMES)
    return ContactSeries(
        nothing, nothing, np.pi * size**2, np.zeros((FRAMES, 2)), np.stack((size, size), axis=1) * 0.95, nothing
    )


def material() -> NDArray[np.float64]:
    axis = np.arange(-4.2, 4.21, 0.38)
    nodes = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    return nodes + 0.1 * np.random.default_rng(1).uniform(-1, 1, nodes.shape)


def positions(motion: Motion, points: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """(T, N, 2) mm at times (T, N) or (T, 1)."""
    velocity = np.array(motion.shift) + points @ np.array(motion.gradient).T
    result: NDArray[np.float64] = points + times[..., None] * velocity
    return result


def _shared(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, N), makes of independent numbers such as correlate by the overlap of tracking windows, as on a press."""
    apart = np.abs(points[:, None] - points) / MM_PER_PX / WINDOW_PX
    root: NDArray[np.float64] = np.linalg.cholesky(np.clip(1 - apart, 0, None).prod(-1))
    return root


def tracked(motion: Motion, points: NDArray[np.float64], seed: int) -> Displacement:
    """Key frame 0: its template's noise is in every later position; a position's covariance is that of both images."""
    draw = np.random.default_rng(seed)
    noise = motion.noise / np.sqrt(2) * (_shared(points) @ draw.standard_normal((FRAMES, *points.shape)))
    exact = positions(motion, points, np.arange(FRAMES, dtype=float)[:, None])
    pixels = exact / MM_PER_PX + noise - noise[0]
    deviation = np.full(pixels.shape[:2], motion.noise, np.float32)
    deviation[0] = 0
    border = 0.5 + SPEED * np.arange(FRAMES)[:, None]
    place = np.linalg.norm(points, axis=1) + deformation._BORDER_MM * draw.standard_normal(len(points))
    return displace(
        inputs(), TrackSeries(pixels, deviation, deviation, np.zeros(deviation.shape, np.uint8)), place < border
    )


def truth(motion: Motion, points: NDArray[np.float64], found: Displacement, late: float) -> Displacement:
    """The same points, from where they were so many frames after the border reached them, without errors."""
    times = np.maximum((np.linalg.norm(points, axis=1) - 0.5) / SPEED + late, 0)
    reference = positions(motion, points, times[None])[0]
    moved = positions(motion, points, np.arange(FRAMES, dtype=float)[:, None]) - reference
    moved[np.isnan(found.displacement)] = np.nan
    exact = np.zeros_like(found.variance)
    of_onset, late = 0 * found.of_onset, 0 * found.late
    return Displacement(found.onset, reference, found.reference_px, moved, exact, of_onset, late, found.vector)


def series(moved: Displacement) -> dict[str, NDArray[Any]]:
    last = slice(FRAMES - 1, None)
    now = moved.__class__(**vars(moved) | {"displacement": moved.displacement[last], "variance": moved.variance[last]})
    ellipse = ContactSeries(**{name: values[last] for name, values in vars(contact()).items()})
    field = fields(inputs(), now, ellipse)
    strain = strains(inputs(), moved, contact())
    return {"displacement": moved.displacement[-1], "displacement_std": moved.displacement_std()[-1][:, None]} | {
        name: values[-1] for part in (field, strain) for name, values in vars(part).items() if name != "triangles"
    }


# Medians sum over many points, whose errors their deviation takes as independent: noise that overlapping windows share
# makes them a quarter larger. Medians and energy are up to half as large again as stated with large errors of onset,
# which are larger at some points than at others.
MOST = {"noise": {"median": 1.35}, "onset": {"median": 1.5, "energy": 1.5}}


@pytest.mark.parametrize("kind", MOTIONS)
def test_errors_are_as_large_as_stated(kind: str) -> None:
    """Within a quarter; 40 copies know the deviation of one number to 11 %, of hundreds far better.

    Of medians the scatter counts: what all copies have in common comes from the frames in which the border is seen."""
    motion, points = MOTIONS[kind], material()
    names = ("displacement", "divergence", "curl", "median", "strain", "energy")
    errors: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
    stated: dict[str, list[NDArray[Any]]] = {name: [] for name in names}
    for seed in range(COPIES):
        moved = tracked(motion, points, seed)
        # The first frame with contact comes half a frame after the contact: no error of differences, but of one place.
        exact = truth(motion, points, moved, 0.5)
        found, true = series(moved), series(exact)
        true["displacement"] = truth(motion, points, moved, 0.0).displacement[-1]
        # Triangles by the places that were found.
        there = exact.__class__(**vars(exact) | {"reference": moved.reference})
        true |= {name: values for name, values in series(there).items() if name in ("strain", "energy")}
        for name in names:
            errors[name].append(np.atleast_1d(found[name] - true[name]))
            stated[name].append(np.atleast_1d(found[f"{name}_std"] + 0 * errors[name][-1]))
    scatter = np.stack(errors["median"])
    errors["median"] = list(scatter - scatter.mean(0))
    for name in names:
        for part in (slice(0, 1), slice(1, 2), slice(2, 5)) if name == "median" else (slice(None),):
            error, deviation = (np.concatenate([one[part].ravel() for one in some[name]]) for some in (errors, stated))
            z = np.sqrt(np.nanmean(error**2) / np.nanmean(deviation**2))
            assert 0.8 < z < MOST[kind].get(name, 1.25), (name, part, z)


@pytest.mark.parametrize("template", ["keyframe", "previous"])
def test_noise_of_the_template_falls_out(template: str) -> None:
    """Key frame 0: a position's variance is 2, half of it the template's; a difference of two positions has 1 + 1."""
    deviation = np.sqrt(np.array([[0, 0], [2, 2], [2, 2], [2, 2]], np.float32))
    if template == "previous":  # they add up
        deviation = np.sqrt(np.array([[0, 0], [2, 2], [4, 4], [6, 6]], np.float32))
    found = deformation._noise_since(deviation, np.array([0, 1], np.int32), template)
    expected = [[0, 2], [2, 0], [2, 2], [2, 2]] if template == "keyframe" else [[0, 2], [2, 0], [4, 2], [6, 4]]
    np.testing.assert_allclose(found[:, 0], np.array(expected)[:, 0], rtol=1e-6)
    np.testing.assert_allclose(found[1:, 1], np.array(expected)[1:, 1], rtol=1e-6, atol=1e-6)


def test_there_is_no_energy_only_where_nothing_touches() -> None:
    """Where all points of a contact are lost, nobody knows its energy; at rest there is none beyond its deviation."""
    motion, points = Motion((0.0, 0.0), ((0.0, 0.0), (0.0, 0.0)), 0.05), material()
    energies = []
    for seed in range(20):
        strain = strains(inputs(), tracked(motion, points, seed), contact())
        energies.append((strain.energy[-1], strain.energy_std[-1]))
    energy, deviation = np.array(energies).T
    assert abs(energy.mean()) < 3 * deviation.mean() / np.sqrt(20)
    lost = tracked(motion, points, 0)
    lost.displacement[20:] = np.nan
    series = contact()
    series.gross_area[3] = 0
    found = strains(inputs(), lost, series).energy
    assert np.isnan(found[20:]).all()
    assert found[3] == 0
    assert np.isfinite(found[15:20]).all()
