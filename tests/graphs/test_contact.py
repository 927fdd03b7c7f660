"""Tests of the contact graph on stripes inside an ellipse: threshold, areas and axes against the drawing."""

import math
from typing import NamedTuple

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from torch import Tensor

from fingerflow.graphs import ContactGraph, FrameContact
from fingerflow.ops.filters.illumination import glass_light

PERIOD_PX = 14.0  # period of ridges 0.45 mm apart
EDGE_PX = 0.35  # width of the logistic blur of an edge in focus


def drawn(
    semi_axes: tuple[float, float], phase: float = 0.0, angle: float = 0.4, share: float = 0.5, valley: float = 0.04
) -> tuple[Tensor, float]:
    """Return the share of light (1, 1, H, W) kept by a contact of straight ridges, and the true real contact
    area, px.
    """
    size = 2 * math.ceil(max(semi_axes)) + 60
    fine = 4  # subpixels a px, to measure the real contact area
    offsets = (torch.arange(size * fine, dtype=torch.float64) + 0.5) / fine - 0.5 - size / 2 + 0.25
    y, x = torch.meshgrid(offsets, offsets, indexing="ij")

    def margins(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        u, v = x / semi_axes[0], y / semi_axes[1]
        radius = torch.hypot(u, v)
        border = (1 - radius) * radius / torch.hypot(u / semi_axes[0], v / semi_axes[1]).clamp_min(1e-12)
        across = (x * math.cos(angle) + y * math.sin(angle)) / PERIOD_PX + phase
        return border, torch.minimum(PERIOD_PX * (share / 2 - (across - across.round()).abs()), border)

    real_area = float((margins(x, y)[1] > 0).sum()) / fine**2
    coarse = torch.arange(size, dtype=torch.float64) - size / 2 + 0.25
    border, ridge = margins(*torch.meshgrid(coarse, coarse, indexing="xy"))
    lost = valley * torch.sigmoid(border / EDGE_PX) + (0.5 - valley) * torch.sigmoid(ridge / EDGE_PX)
    return (1 - lost).float()[None, None], real_area


class Measured(NamedTuple):
    contact: FrameContact
    threshold: Tensor


def found(
    frames: Tensor, reference: Tensor, graph: ContactGraph | None = None, threshold: Tensor | None = None
) -> Measured:
    """Return the contact and its threshold: the given one, or one measured in each frame."""
    graph = graph or ContactGraph()
    light, black = glass_light(reference)
    if threshold is None:
        threshold = graph.threshold(frames, light, black)
    return Measured(graph(frames, light, black, 1 - threshold), threshold)


def measured(light: Tensor, noise: float = 0.0, graph: ContactGraph | None = None) -> Measured:
    levels = 180 * light + noise * torch.randn(light.shape, generator=torch.Generator().manual_seed(0))
    return found(levels.round().to(torch.uint8), torch.full_like(light, 180.0), graph)


@pytest.mark.parametrize("noise", [0.0, 3.0])
@pytest.mark.parametrize("share", [0.17, 0.25, 0.35, 0.5, 0.6, 0.8])
def test_threshold_and_area_of_thin_and_wide_ridges(share: float, noise: float) -> None:
    """The threshold lies half-way between full contact and valley to 0.008, and both contact areas have an error of at
    most 2 %, also where ridges (share 0.17) or valleys (0.8) are only 2 to 3 px wide. Half-way between the medians of
    ridges and of valleys it would lie 0.04 too low or 0.03 too high. One byte of the signal is 1/204.
    """
    light, real_area = drawn((120, 95), share=share)
    contact, threshold = measured(light, noise)
    assert float(threshold) == pytest.approx((0.5 + 0.04) / 2, abs=0.008)
    assert float(contact.real_area_px) == pytest.approx(real_area, rel=0.02)
    assert float(contact.gross_area_px) == pytest.approx(math.pi * 120 * 95, rel=0.02)


@pytest.mark.parametrize(("share", "tolerance"), [(0.2, 0.008), (0.5, 0.004), (0.8, 0.004)])
def test_threshold_behind_a_lens(share: float, tolerance: float) -> None:
    """The threshold lies half-way between full contact and valley where a lens blurs ridges by a Gaussian of 0.5 px and
    each pixel averages over its area. Ridges 2.8 px wide do not reach full contact then, which costs 0.004.
    """
    size, fine, centre = 240, 6, 119.75
    places = (np.arange(size * fine) + 0.5) / fine - 0.5 - centre
    x, y = np.meshgrid(places, places)
    gross = np.hypot(x / 95, y / 85) < 1
    across = (x * math.cos(0.6) + y * math.sin(0.6)) / PERIOD_PX
    lost = 0.04 * gross + 0.46 * (gross & (np.abs(across - across.round()) < share / 2))
    pixels = gaussian_filter(lost.astype(np.float32), 0.5 * fine).reshape(size, fine, size, fine).mean((1, 3))
    threshold = measured(1 - torch.from_numpy(pixels)[None, None], 1.0).threshold
    assert float(threshold) == pytest.approx(0.27, abs=tolerance)


def test_threshold_with_defective_pixels() -> None:
    """One pixel in 500 is black or saturated. That moves the threshold by at most 0.004; without the median of three
    pixels it would move by more than 0.06, as their edges are the steepest.
    """
    light, _ = drawn((120, 95))
    draw = torch.Generator().manual_seed(1)
    levels = (180 * light + 2 * torch.randn(light.shape, generator=draw)).round().to(torch.uint8)
    defect = torch.rand(light.shape, generator=draw) < 0.002
    spoilt = torch.where(defect, 255 * torch.randint(2, light.shape, generator=draw), levels).to(torch.uint8)
    clean, found_again = (found(one, torch.full_like(light, 180.0)).threshold for one in (levels, spoilt))
    torch.testing.assert_close(found_again, clean, rtol=0, atol=0.004)


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_threshold_without_valleys(noise: float) -> None:
    """In a contact without valleys the threshold lies half-way between contact and empty glass. The noise of its many
    pixels without an edge does not move it.
    """
    light, _ = drawn((220, 200), share=1.6)
    assert float(measured(light, noise).threshold) == pytest.approx(0.25, abs=0.008)


@pytest.mark.parametrize("noise", [0.0, 2.0])
@pytest.mark.parametrize("semi_axes", [(170, 140), (100, 80)])
def test_real_area(semi_axes: tuple[float, float], noise: float) -> None:
    """The real contact area is found to 0.8 %: the median takes 2 px off every end of a ridge, and border
    pixels round.
    """
    for phase in (0.0, 0.25, 0.5, 0.75):
        light, real_area = drawn(semi_axes, phase)
        assert float(measured(light, noise).contact.real_area_px) == pytest.approx(real_area, rel=0.008)


@pytest.mark.parametrize(("semi_axes", "each", "mean"), [((170, 140), 0.01, 0.004), ((60, 50), 0.04, 0.012)])
def test_gross_area_and_axes_are_unbiased(semi_axes: tuple[float, float], each: float, mean: float) -> None:
    """Gross contact area and axes have an error that averages out over the phases of the ridges. Where the border runs
    along a ridge or valley, a picture does not show how far into the ridge or valley the contact reaches: half a period
    at two places, 7 px of 60 or 170 px, over a small part of the circumference.
    """
    areas, axes = [], []
    for angle in (0.0, 0.8):
        for phase in np.arange(8) / 8:
            contact, _ = measured(drawn(semi_axes, float(phase), angle)[0])
            areas.append(float(contact.gross_area_px) / (math.pi * semi_axes[0] * semi_axes[1]) - 1)
            axes.append(contact.semi_axes[0].numpy() / semi_axes - 1)
    assert np.abs(areas).max() < each
    assert np.abs(axes).max() < each
    assert abs(np.mean(areas)) < mean
    assert np.abs(np.mean(axes, axis=0)).max() < mean


@pytest.mark.parametrize("level", [0, 180, 255])
def test_blank_and_saturated_frames_have_no_contact_of_their_own(level: int) -> None:
    frames = torch.full((2, 1, 64, 80), level, dtype=torch.uint8)
    contact, threshold = found(frames, torch.full((1, 1, 64, 80), 180.0))
    assert threshold.isnan().all()
    assert (contact.real_area_px == 0).all()
    assert (contact.gross_area_px == 0).all()
    assert contact.semi_axes.isnan().all()


def test_bad_pixels_and_an_unlit_rim_are_no_contact() -> None:
    light, _ = drawn((60, 50))
    frames = 180 * light
    reference = torch.full_like(light, 180.0)
    expected, _ = found(frames, reference)
    frames[..., 40, 60], frames[..., 70, 80], frames[..., :4, :] = torch.nan, torch.inf, 3.0
    reference[..., :4, :] = 0.0
    contact, _ = found(frames, reference)
    assert not contact.real_contact_mask[..., :4, :].any()
    assert abs(float(contact.real_area_px - expected.real_area_px)) <= 20
    assert float(contact.gross_area_px) == pytest.approx(float(expected.gross_area_px), rel=0.003)


@pytest.mark.parametrize("factor", [1.4, 16.0])
def test_frames_brighter_than_the_background_have_no_contact(factor: float) -> None:
    """Frames brighter than the background, by another exposure or by 12 bit against 8, have two classes of light but no
    contact, because neither class lost light.
    """
    light, _ = drawn((60, 50))
    contact, threshold = found(factor * 2 * 180 * light, torch.full_like(light, 180.0))
    assert threshold.isnan().all()
    assert float(contact.real_area_px) == 0


@pytest.mark.parametrize("gain", [0.8, 0.93, 1.2])
def test_light_that_has_changed_moves_nothing(gain: float) -> None:
    """The gain of the lamp is measured on the glass around the contact, so that areas stay within 0.5 % and the
    threshold within 0.004.
    """
    light, _ = drawn((120, 95))
    steady, changed = measured(light, 2.0), measured(gain * light, 2.0)
    assert float(changed.contact.illumination_gain) == pytest.approx(gain, rel=0.002)
    assert float(changed.threshold) == pytest.approx(float(steady.threshold), abs=0.004)
    for name in ("real_area_px", "gross_area_px"):
        expected = getattr(steady.contact, name)
        torch.testing.assert_close(getattr(changed.contact, name), expected, rtol=0.005, atol=0)


@pytest.mark.parametrize("stride", [2, 4, 8])
def test_a_stride_has_nearly_the_threshold_of_all_pixels(stride: int) -> None:
    light, _ = drawn((120, 95))
    exact, coarse = (measured(light, 2.0, ContactGraph(3, stride_px=step)).threshold for step in (1, stride))
    torch.testing.assert_close(coarse, exact, rtol=0, atol=0.001 * stride)


@pytest.mark.usefixtures("each_form")
def test_autocast_does_not_round_the_threshold() -> None:
    light, _ = drawn((90, 40))
    exact = measured(light, 4.0).threshold
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(measured(light, 4.0).threshold, exact)
