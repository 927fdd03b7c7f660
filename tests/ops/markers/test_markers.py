"""Tests of markers: detection at their own scale to the precision that noise allows, and matching across jumps."""

import math

import pytest
import torch
from torch import Tensor

from fingerflow.ops.contact.light_change import light_change
from fingerflow.ops.markers.marker_matching import match_markers, tie_neighbours
from fingerflow.ops.markers.markers import detect_markers, measure_markers

HEIGHT, WIDTH, RADIUS = 120, 160, 5.0


def lattice(spacing: float = 28.0, seed: int = 0) -> Tensor:
    """Return positions (N, 2) px of markers inside the image, off whole pixels."""
    x, y = torch.meshgrid(torch.arange(20, WIDTH - 15, spacing), torch.arange(18, HEIGHT - 14, spacing), indexing="xy")
    places = torch.stack((x.flatten(), y.flatten()), dim=-1).double()
    return places + torch.rand(places.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 0.5


def picture(places: Tensor, radius: float = RADIUS, noise: float = 1.0, contrast: float = -80.0) -> Tensor:
    """Return soft discs on uneven light, (1, 1, H, W) uint8: each pixel is the mean of an exact function at 4 x 4
    points.
    """
    fine = (torch.arange(4, dtype=torch.float64) + 0.5) / 4 - 0.5
    y, x = ((torch.arange(size, dtype=torch.float64)[:, None] + fine).flatten() for size in (HEIGHT, WIDTH))
    far = torch.full((len(y), len(x)), torch.inf, dtype=torch.float64)
    for place in places:
        far = torch.minimum(far, torch.hypot(x - place[0], y[:, None] - place[1]))
    exact = 120 + 0.15 * x + contrast * torch.sigmoid((radius - far) / 0.7)
    exact = exact.reshape(HEIGHT, 4, WIDTH, 4).mean((1, 3))
    noisy = exact + noise * torch.randn(exact.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    return noisy.round().clamp(0, 255).to(torch.uint8)[None, None]


def errors(found: Tensor, places: Tensor) -> Tensor:
    return torch.cdist(found.double(), places).amin(1)


@pytest.mark.parametrize("contrast", [-80.0, 80.0])
@pytest.mark.parametrize("radius", [3.0, 5.0, 7.0])
def test_markers_are_found_as_exactly_as_they_say(radius: float, contrast: float) -> None:
    """Markers are found to 0.06 px RMS: noise contributes 0.01 px, the slope of the light and peaks of the noise the
    rest.
    """
    places = lattice()
    frame = picture(places, radius, contrast=contrast)
    look = measure_markers(frame)
    assert look is not None
    assert look.polarity == (1 if contrast < 0 else -1)
    assert look.radius == pytest.approx(radius, rel=0.2)  # soft borders; bright markers raise the background
    found = detect_markers(frame, look)
    assert len(found.points[0]) == len(places)
    assert float(errors(found.points[0], places).square().mean().sqrt()) < 0.06
    assert float(found.disagreement.max()) < 0.2


def test_the_covariance_is_that_of_the_noise() -> None:
    """The stated covariance agrees within a fifth with the scatter in 40 images with noise of 3 grey levels; 30 markers
    give the scatter to 3 %.
    """
    places = lattice()
    clean = picture(places, noise=0.0).double()
    look = measure_markers(clean)
    assert look is not None
    generator = torch.Generator().manual_seed(5)
    noise = torch.randn((40, *clean.shape[1:]), generator=generator, dtype=torch.float64)
    found = [detect_markers((clean + 3 * one).float(), look) for one in noise[:, None]]
    order = [torch.cdist(places, one.points[0].double()).argmin(1) for one in found]
    points = torch.stack([one.points[0, k] for one, k in zip(found, order, strict=True)]).double()
    said = torch.stack([one.covariance[0, k] for one, k in zip(found, order, strict=True)]).diagonal(dim1=-2, dim2=-1)
    assert float(points.var(0).mean() / said.mean()) == pytest.approx(1, abs=0.2)


def test_the_gain_of_the_light_changes_nothing() -> None:
    """At 0.6 of the exposure the same markers are found, within 0.05 px."""
    places = lattice()
    frame = picture(places, noise=0.0)
    look = measure_markers(frame)
    assert look is not None
    dim = (0.6 * frame).round().to(torch.uint8)
    assert float(errors(detect_markers(dim, look).points[0], places).max()) < 0.05


def test_nothing_is_found_where_nothing_is_printed() -> None:
    blank = torch.full((1, 1, HEIGHT, WIDTH), 120, dtype=torch.uint8)
    noisy = (120 + 5 * torch.randn(blank.shape, generator=torch.Generator().manual_seed(3))).round().to(torch.uint8)
    assert measure_markers(blank) is None
    assert measure_markers(noisy) is None
    look = measure_markers(picture(lattice()))
    assert look is not None
    assert detect_markers(blank, look).points.shape[1] == 0
    with pytest.raises(ValueError, match="give one picture"):
        measure_markers(blank[0])
    with pytest.raises(ValueError, match="give \\(B, 1, H, W\\)"):
        detect_markers(blank[0], look)


def test_a_fold_beside_a_marker_shows_in_the_disagreement() -> None:
    """A dark band 6 px from a marker's centre raises its disagreement between two scales above three
    times the median.
    """
    places = lattice()
    frame = picture(places, noise=0.0)
    look = measure_markers(frame)
    assert look is not None
    x = int(places[12, 0].round()) + 6
    y = int(places[12, 1].round())
    frame[0, 0, y - 12 : y + 13, x : x + 5] = 40
    found = detect_markers(frame, look)
    beside = torch.cdist(found.points[0].double(), places[12:13])[:, 0].argmin()
    assert float(found.disagreement[0, beside]) > 3 * float(found.disagreement[0].median())


def test_a_jump_of_nearly_a_spacing_is_read_right() -> None:
    """Markers are matched although part of the gel moves by up to 0.9 spacings, where the nearest marker is the wrong
    one for at least three markers.
    """
    reference = lattice()
    ties = tie_neighbours(reference)
    moved = reference.clone()
    moved[:, 1] += 0.9 * ties.spacing * ((reference[:, 0] - 60) / (WIDTH - 80)).clamp(0, 1)
    aliased = torch.cdist(reference, moved).argmin(1) != torch.arange(len(reference))
    assert aliased.sum() >= 3
    order = torch.randperm(len(moved), generator=torch.Generator().manual_seed(2))
    number = match_markers(reference, ties, reference, moved[order])
    assert torch.equal(order[number], torch.arange(len(reference)))


def test_a_hidden_marker_is_not_taken_for_its_neighbour() -> None:
    reference = lattice()
    ties = tie_neighbours(reference)
    seen = torch.arange(len(reference)) != 7
    number = match_markers(reference, ties, reference, (reference + 3.0)[seen])
    assert int(number[7]) == -1
    assert torch.equal(number[seen], torch.arange(int(seen.sum())))
    assert (match_markers(reference, ties, reference, reference[:0]) == -1).all()


@pytest.mark.parametrize("spacing", [20.0, 100.0])
def test_a_detection_half_way_between_two_markers_is_of_one(spacing: float) -> None:
    reference = torch.tensor([[0.0, 0.0], [spacing, 0.0]])
    number = match_markers(reference, tie_neighbours(reference), reference, reference.mean(0, keepdim=True))
    assert number.tolist() == [0, -1]


def test_change_of_light_is_seen_beside_markers_that_move() -> None:
    """A bump of 10 % in the light is found to 1 % under markers that moved by 4 px; elsewhere the change is below 1 %,
    whatever the exposure.
    """
    places = lattice()
    rest = picture(places, noise=0.0).float()
    y, x = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    far = torch.hypot(x - 80.0, y - 60.0)
    frame = 0.8 * picture(places + 4.0, noise=0.0).float() * (1 + 0.1 * torch.sigmoid((25 - far) / 2))
    hidden = torch.zeros_like(rest, dtype=torch.bool)
    for place in (*places, *(places + 4.0)):
        hidden[0, 0] |= torch.hypot(x - place[0], y - place[1]) < RADIUS + 4
    change = light_change(frame, rest, hidden, 4, 4.0)[0, 0]
    cells = far[2::4, 2::4]
    known = change.isfinite()
    assert known.float().mean() > 0.9
    assert float((change[known & (cells < 12)] - math.log(1.1)).abs().max()) < 0.01
    assert float(change[known & (cells > 45)].abs().max()) < 0.01
    with pytest.raises(ValueError, match="hidden"):
        light_change(frame, rest, hidden[..., 1:], 4, 4.0)
