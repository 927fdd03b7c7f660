"""Medians over the area of a deformed ellipse, against closed forms, by both forms of the op."""

from typing import Any

import pytest
import torch
from torch import Tensor

from fingerflow.ops.area_medians import area_medians

STEP, ROWS, COLUMNS = 0.2, 61, 71
ORIGIN = (1.0, 0.0)


pytestmark = pytest.mark.usefixtures("each_form")


def nodes() -> Tensor:
    """(2, ROWS, COLUMNS) float64."""
    y, x = (torch.arange(count, dtype=torch.float64) * STEP for count in (ROWS, COLUMNS))
    y, x = torch.meshgrid(y, x, indexing="ij")
    return torch.stack((x + ORIGIN[0], y + ORIGIN[1]))


def medians(
    fields: Tensor,
    displacement: Tensor,
    semi_axes: tuple[float, float] = (4.0, 4.0),
    center: tuple[float, float] = (8.0, 6.0),
    angle: float = 0.0,
) -> Tensor:
    """Medians (K,) of fields (K, R, C)."""
    ellipse = torch.tensor([center]), torch.tensor([semi_axes]), torch.tensor([angle])
    return area_medians(fields[None].float(), displacement[None].float(), ORIGIN, STEP, *ellipse, 0.15)[0]


@pytest.mark.parametrize("dilation", [0.0, 0.12, -0.2])
def test_median_is_that_of_the_current_area(dilation: float) -> None:
    """f = |X - c|^2 while skin moves by s (X - c): over a disc of radius R the median is R^2 / 2 / (1 + s)^2.

    Over reference positions it would be R^2 / 2. Tolerance: 2,300 positions, and a bilinear field (0.2^2 / 4 mm^2)."""
    away = nodes() - torch.tensor([8.0, 6.0])[:, None, None]
    median = medians(away.square().sum(0)[None], dilation * away)
    assert median.item() == pytest.approx(16 / 2 / (1 + dilation) ** 2, rel=0.01)


def test_a_turned_ellipse() -> None:
    """The median of |along| over an ellipse of semi-axes a, b is 0.40397 a (half the area of a unit disc lies within
    that distance of a diameter), and of |across| 0.40397 b."""
    away, angle = nodes() - torch.tensor([8.0, 6.0])[:, None, None], torch.tensor(0.5)
    along, across = (away[0] * x + away[1] * y for x, y in ((angle.cos(), angle.sin()), (-angle.sin(), angle.cos())))
    found = medians(torch.stack((along.abs(), across.abs())), torch.zeros_like(away), (4.5, 2.5), angle=0.5)
    torch.testing.assert_close(found, 0.40397 * torch.tensor([4.5, 2.5], dtype=torch.float64), rtol=0.005, atol=0)


def test_where_nothing_is_known_nothing_is_said() -> None:
    places = nodes()
    still = torch.zeros_like(places)
    assert medians(torch.full_like(places, torch.nan), still).isnan().all()
    assert medians(places, torch.full_like(places, torch.nan)).isnan().all()
    for axes in ((torch.nan, torch.nan), (0.0, 0.0), (-1.0, 2.0), (torch.inf, 1.0)):
        assert medians(places, still, axes).isnan().all()
    assert medians(places, still, (2.0, 2.0), center=(500.0, 500.0)).isnan().all()
    assert medians(places, still, angle=torch.nan).isnan().all()
    none = area_medians(
        torch.zeros(0, 3, 4, 5),
        torch.zeros(0, 2, 4, 5),
        ORIGIN,
        STEP,
        torch.zeros(0, 2),
        torch.zeros(0, 2),
        torch.zeros(0),
        1.0,
    )
    assert none.shape == (0, 3)
    assert medians(places[:0], still).shape == (0,)


@pytest.mark.parametrize("axes", [(0.1, 0.05), (3.0, 1e-4), (1e-6, 1e-6)])
def test_a_tiny_or_thin_ellipse_has_enough_positions(axes: tuple[float, float]) -> None:
    places = nodes()
    torch.testing.assert_close(
        medians(places, torch.zeros_like(places), axes), torch.tensor([8.0, 6.0]).double(), rtol=0, atol=1e-6
    )


def test_what_travelled_further_than_the_ellipse_is_wide() -> None:
    places = nodes()
    far = torch.zeros_like(places) + torch.tensor([20.0, -15.0])[:, None, None]
    found = medians(places, far, (3.0, 3.0), center=(28.0, -9.0))
    torch.testing.assert_close(found, torch.tensor([8.0, 6.0]).double(), rtol=0, atol=1e-5)


def test_half_of_an_area_is_not_taken_for_all_of_it() -> None:
    places = nodes()
    field = torch.where(places[0] < 8.0, 1.0, torch.nan)[None]
    other = torch.where(places[0] < 10.9, 1.0, torch.nan)[None]  # 0.97 of the disc
    found = medians(torch.cat((field, other)), torch.zeros_like(places), (3.0, 3.0))
    assert found[0].isnan()
    assert found[1] == 1


def test_positions_are_led_back_to_where_the_displacement_brings_them_from() -> None:
    """By the medians of the positions themselves over a disc of 1 um, with unknown nodes around; 1e-5 mm: float32."""
    places = nodes()
    away = places - torch.tensor([8.0, 6.0])[:, None, None]
    displacement = torch.stack((15 - 0.1 * away[1] + 0.05 * away[0], 0.3 * away[0] - 0.2 * away[1]))
    displacement[:, away.square().sum(0) > 16] = torch.nan
    for turn in torch.linspace(0, 6, 7).tolist():
        x, y = 2.5 * torch.tensor(turn).cos().item(), 2.5 * torch.tensor(turn).sin().item()
        current = (8 + x + 15 - 0.1 * y + 0.05 * x, 6 + y + 0.3 * x - 0.2 * y)
        found = medians(places, displacement, (1e-3, 1e-3), center=current)
        torch.testing.assert_close(found, torch.tensor([8 + x, 6 + y]).double(), rtol=0, atol=1e-5)


def test_bilinear_between_nodes_and_nothing_beyond() -> None:
    """The product of x and y is bilinear: exact to float32; a cell beside a NaN and places off the grid are unknown."""
    places = nodes()
    field = (places[0] * places[1])[None]
    field[0, 30, 35] = torch.nan
    still = torch.zeros_like(places)
    tiny = (1e-6, 1e-6)
    assert medians(field, still, tiny, center=(5.03, 3.33)).item() == pytest.approx(5.03 * 3.33, rel=1e-5)
    assert medians(field, still, tiny, center=(8.1, 6.1)).isnan().all()
    assert medians(field, still, tiny, center=(8.3, 6.1)).isfinite().all()
    for nowhere in ((0.99, 5.0), (15.01, 5.0), (5.0, -0.01), (5.0, 12.01)):
        assert medians(field, still, tiny, center=nowhere).isnan().all()


def test_double_precision() -> None:
    """Float64 nodes go the portable way: the product of x and y to 1e-9, the size of the ellipse."""
    places = nodes()
    ellipse = torch.tensor([[5.03, 3.33]], dtype=torch.float64), torch.full((1, 2), 1e-9), torch.zeros(1)
    found = area_medians(
        (places[0] * places[1])[None, None], torch.zeros_like(places)[None], ORIGIN, STEP, *ellipse, 0.1
    )
    assert found.item() == pytest.approx(5.03 * 3.33, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"fields": torch.zeros(1, 2, 5, 5, dtype=torch.int32)}, TypeError, "fields must be floating"),
        ({"fields": torch.zeros(1, 2, 1, 5)}, ValueError, "at least 2 x 2"),
        ({"displacement": torch.zeros(1, 3, 5, 5)}, ValueError, "displacement"),
        ({"displacement": torch.zeros(2, 2, 5, 5)}, ValueError, "displacement"),
        ({"center": torch.zeros(2, 2)}, ValueError, "center must be"),
        ({"angle": torch.zeros(1, 1)}, ValueError, "angle must be"),
        ({"origin": (1.0,)}, ValueError, "origin must be"),
        ({"step": 0.0}, ValueError, "step must be"),
        ({"spacing": float("nan")}, ValueError, "spacing must be"),
    ],
)
def test_wrong_input(change: dict[str, Any], kind: type[Exception], message: str) -> None:
    given: dict[str, Any] = {
        "fields": torch.zeros(1, 2, 5, 5),
        "displacement": torch.zeros(1, 2, 5, 5),
        "origin": ORIGIN,
        "step": STEP,
        "center": torch.zeros(1, 2),
        "semi_axes": torch.ones(1, 2),
        "angle": torch.zeros(1),
        "spacing": 0.1,
    }
    with pytest.raises(kind, match=message):
        area_medians(**(given | change))
