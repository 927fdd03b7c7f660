"""Stress under a cylinder, pressed and rubbed, against another library: tamaas, spectral, written independently.

tamaas (AGPL-3.0, of the extra `dev` alone, on Linux where it has wheels) gives the stress in an elastic volume under
a periodic load by its Fourier components, and has no part in this project's strips. What it needs is a period, here 16
half widths of the contact, and a load without mean, because its Boussinesq operator leaves the mean out.
"""

import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from fingerflow.models.half_space import Stress, stress

tamaas = pytest.importorskip("tamaas", reason="tamaas (extra `dev`) has wheels for Linux on x86-64 alone")

PERIOD, DEPTH, LAYERS = 16.0, 4.0, 9  # in half widths of the contact; layers from the surface to the depth
IMAGES = 16  # on either side: those further out add less than 3e-6, see `test_images_suffice`
POISSON = 0.4
DEPTHS = torch.linspace(0, DEPTH, LAYERS, dtype=torch.float64)[1:, None]


def hertzian(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places over one period, and sqrt(1 - s^2) less its mean there."""
    places = PERIOD * (np.arange(count) / count - 0.5)
    load = np.sqrt(np.clip(1 - places**2, 0, None))
    return places, load - load.mean()


def theirs(pressure: NDArray[np.float64], traction: NDArray[np.float64]) -> NDArray[np.float64]:
    """(LAYERS, places, 6): yy, xx, zz, and sqrt 2 times xz, yz, xy in this project's axes (Mandel's notation)."""
    tamaas.set_log_level(tamaas.LogLevel.error)
    count = len(pressure)
    model = tamaas.ModelFactory.createModel(tamaas.model_type.volume_2d, [DEPTH, PERIOD, 1.0], [LAYERS, count, 1])
    model.E, model.nu = 1.0, POISSON
    tamaas.ModelFactory.registerVolumeOperators(model)
    model.traction[...] = 0
    model.traction[:, 0, 0], model.traction[:, 0, 2] = traction, pressure
    gradient, found = np.zeros((2, LAYERS, count, 1, 6))
    model.operators["boussinesq_gradient"](model.traction, gradient)
    model.operators["hooke"](gradient, found)
    return found[:, :, 0]


def ours(pressure: NDArray[np.float64], traction: NDArray[np.float64], y: torch.Tensor, images: int = IMAGES) -> Stress:
    count, periods = len(pressure), 2 * images + 1
    nodes = PERIOD * (np.arange(count * periods + 1) / count - periods / 2)
    edges = np.concatenate((nodes[:1], (nodes[1:] + nodes[:-1]) / 2, nodes[-1:]))
    repeated = [np.append(np.tile(load, periods), load[0]) for load in (pressure, traction)]
    # Between contacts the load is even: strips there can be joined.
    begins = np.concatenate(([True], np.abs(np.diff(repeated)).max(0) > 0))
    joined = np.append(edges[:-1][begins], edges[-1])
    return stress(y, DEPTHS, *(torch.from_numpy(values) for values in (joined, *(load[begins] for load in repeated))))


@pytest.mark.parametrize("load", ["pressure", "traction"])
def test_stress_below_a_hertzian_cylinder(load: str) -> None:
    """All three, 0.5 to 4 half widths down, to 4e-5 of the largest pressure with 1,024 nodes a period.

    They have the same values at nodes, theirs joined by sines and ours even around each: so the difference is of second
    order in their distance, 16 times smaller with 4 times the nodes. The stress that plane strain has across is nu
    times the sum of the other two, in theirs too.
    """
    worst = []
    for count in (256, 1024):
        places, shape = hertzian(count)
        loads = (shape, 0 * shape) if load == "pressure" else (0 * shape, shape)
        every = slice(None, None, count // 32)
        reference = theirs(*loads)[1:, every]
        found = ours(*loads, torch.from_numpy(places[every]))
        scale = np.array([1, 1, 1 / math.sqrt(2)])
        apart = np.abs(torch.stack(found, -1).numpy() - reference[..., [0, 2, 4]] * scale)
        assert (np.abs(reference[..., [0, 2, 4]]).max((0, 1)) > 0.2).all()
        np.testing.assert_allclose(reference[..., 1], POISSON * (reference[..., 0] + reference[..., 2]), atol=1e-14)
        worst.append(apart.max())
    assert worst[1] < 4e-5
    assert worst[0] > 12 * worst[1]


def test_images_suffice() -> None:
    """Twice as many change nothing that the comparison above could see."""
    places, shape = hertzian(256)
    y = torch.from_numpy(places[::32])
    for loads in ((shape, 0 * shape), (0 * shape, shape)):
        few, many = (torch.stack(ours(*loads, y, images)) for images in (IMAGES, 2 * IMAGES))
        assert (few - many).abs().max() < 3e-6
