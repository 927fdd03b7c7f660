"""Medians over the area of the current contact, against closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest

from fingerflow.stages.contact_medians import ReferenceGrid, medians_over_contact


def contact(semi_axes: tuple[float, float], center: tuple[float, float] = (8.0, 6.0), angle: float = 0.0) -> object:
    return SimpleNamespace(
        semi_axes=np.array([semi_axes]), center=np.array([center]), angle=np.array([angle]), gross_area=np.array([1.0])
    )


def grid() -> tuple[ReferenceGrid, np.ndarray]:
    made = ReferenceGrid.around(np.array([[2.0, 1.0], [14.0, 11.0], [np.nan, 0.0]]), 0.2, 1.0)
    assert made is not None
    return made, made.nodes()


@pytest.mark.parametrize("dilation", [0.0, 0.12, -0.2])
def test_median_is_that_of_the_current_area(dilation: float) -> None:
    """f = |X - c|^2 while skin moves by s (X - c): over a disc of radius R the median is R^2 / 2 / (1 + s)^2.

    Over reference positions it would be R^2 / 2. Tolerance: 3,700 positions, and a bilinear field (0.2^2 / 4 mm^2)."""
    made, nodes = grid()
    away = nodes - (8.0, 6.0)
    median = medians_over_contact(
        contact((4.0, 4.0)),
        0,
        made,
        dilation * away.T,
        (away**2).sum(1)[None],  # type: ignore[arg-type]
    )
    assert median[0] == pytest.approx(16 / 2 / (1 + dilation) ** 2, rel=0.01)


def test_a_turned_ellipse() -> None:
    """The median of |along| over an ellipse of semi-axes a, b is 0.40397 a (half the area of a unit disc lies within
    that distance of a diameter)."""
    made, nodes = grid()
    along = (nodes - (8.0, 6.0)) @ (np.cos(0.5), np.sin(0.5))
    median = medians_over_contact(
        contact((4.5, 2.5), angle=0.5),
        0,
        made,
        np.zeros((2, len(nodes))),
        np.abs(along)[None],  # type: ignore[arg-type]
    )
    assert median[0] == pytest.approx(0.40397 * 4.5, rel=0.01)


def test_where_nothing_is_known_nothing_is_said() -> None:
    made, nodes = grid()
    unknown = np.full((1, len(nodes)), np.nan)
    still = np.zeros((2, len(nodes)))
    assert np.isnan(medians_over_contact(contact((4.0, 3.0)), 0, made, still, unknown)).all()  # type: ignore[arg-type]
    for axes in ((np.nan, np.nan), (0.0, 0.0)):
        assert np.isnan(medians_over_contact(contact(axes), 0, made, still, still)).all()  # type: ignore[arg-type]
    far = contact((2.0, 2.0), center=(500.0, 500.0))
    assert np.isnan(medians_over_contact(far, 0, made, still, still)).all()  # type: ignore[arg-type]
    assert ReferenceGrid.around(np.full((3, 2), np.nan), 0.2, 1.0) is None


def test_a_tiny_contact_has_as_many_positions() -> None:
    made, nodes = grid()
    median = medians_over_contact(
        contact((0.1, 0.05)),
        0,
        made,
        np.zeros((2, len(nodes))),
        nodes.T,  # type: ignore[arg-type]
    )
    np.testing.assert_allclose(median, (8.0, 6.0), atol=1e-6)


def test_skin_that_travelled_further_than_the_contact_is_wide() -> None:
    made, nodes = grid()
    far = np.tile([[20.0], [-15.0]], len(nodes))
    moved = contact((3.0, 3.0), center=(28.0, -9.0))
    median = medians_over_contact(moved, 0, made, far, nodes.T)  # type: ignore[arg-type]
    np.testing.assert_allclose(median, (8.0, 6.0), atol=0.02)


def test_half_of_a_contact_is_not_taken_for_all_of_it() -> None:
    made, nodes = grid()
    field = np.where(nodes[:, 0] < 8.0, 1.0, np.nan)[None]
    still = np.zeros((2, len(nodes)))
    assert np.isnan(medians_over_contact(contact((3.0, 3.0)), 0, made, still, field)).all()  # type: ignore[arg-type]


def test_positions_are_led_back_to_where_the_displacement_brings_them_from() -> None:
    """To 1e-9 mm, with unknown nodes around them."""
    made, nodes = grid()
    away = nodes - (8.0, 6.0)
    displacement = np.stack(
        (15 + 0.02 * away[:, 0] ** 2 - 0.1 * away[:, 1], 0.3 * np.sin(away[:, 0]) - 0.2 * away[:, 1])
    )
    displacement[:, (away**2).sum(1) > 16] = np.nan
    angle, radius = np.linspace(0, 40, 1000), np.sqrt(np.linspace(0, 9, 1000))
    reference = np.stack((8 + radius * np.cos(angle), 6 + radius * np.sin(angle)))
    found, settled = made.led_back(reference + made.interpolate(displacement, reference), displacement)
    assert settled.all()
    np.testing.assert_allclose(found, reference, rtol=0, atol=1e-9)


def test_bilinear_interpolation() -> None:
    made, nodes = grid()
    field = np.stack((nodes[:, 0] * nodes[:, 1], nodes.sum(1)))
    field[:, 0] = np.nan
    low, high = nodes[0], nodes[-1]
    inside = np.array([[5.03, 7.9, high[0], low[0] + 0.3], [2.0, 3.333, high[1], low[1] + 0.1]])
    np.testing.assert_allclose(made.interpolate(field, inside), [inside.prod(0), inside.sum(0)], atol=1e-12)
    nowhere = np.array(
        [[low[0] + 0.1, low[0] - 0.01, high[0] + 0.01, 5.0, np.nan], [low[1] + 0.1, 2.0, 2.0, 99.0, 3.0]]
    )
    assert np.isnan(made.interpolate(field, np.array(nowhere))).all()
