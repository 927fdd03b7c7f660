"""Tests of the matching of discs and of the transform between two views, against drawings of known transform."""

import tomllib
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn_discs import TARGET, Array, DrawnDisc, as_found, camera, draw, moved, similarity
from hypothesis import given, settings
from hypothesis import strategies as st

from fingerflow.calibration import Calibration, Transform, calibrate, fit_affine, fit_similarity, match_discs
from fingerflow.errors import FingerflowError
from fingerflow.schema.calibration_file import read_calibration
from fingerflow.schema.json_value import json_value
from fingerflow.schema.views import View

SHAPE = (256, 272)
MIDDLE = (135.5, 127.5)
VIEWS = {"topography": View((0, 256), (0, 272)), "contact": View((0, 256), (272, 544))}
MIRROR = np.array([[-1.0, 0, 271], [0, 1.0, 0]])
# One axis is shortened by a tenth, as by an oblique camera, and turned by 30 degrees.
OBLIQUE = np.column_stack([similarity(30, 1.0, MIDDLE, MIDDLE)[:, :2] @ np.diag([1.0, 0.9]), (0, 0)])
OBLIQUE[:, 2] = np.array(MIDDLE) - OBLIQUE[:, :2] @ MIDDLE


def applied(matrix: Array, points: Array) -> Array:
    return points @ matrix[:, :2].T + matrix[:, 2]


Discs = tuple[DrawnDisc, ...]
_OTHER = DrawnDisc(20, 20, 29, 29), DrawnDisc(250, 30, 20, 20), DrawnDisc(130, 70, 20, 20)
_LINE = tuple(DrawnDisc(40.0 + 60 * k, 50.0 + 45 * k, 20 + k, 20 + k) for k in range(3))
_EVEN = tuple(DrawnDisc(128 + 80 * np.cos(t), 128 + 80 * np.sin(t), 20, 20) for t in 2 * np.pi * np.arange(3) / 3)


def ring(hole_radius: float, noise: float = 1.0) -> Array:
    metal = draw((DrawnDisc(140.2, 126.7, 110, 110),), SHAPE, bright=0, dark=60)
    hole = draw((DrawnDisc(141.6, 128.3, hole_radius, hole_radius),), SHAPE, bright=0, dark=50)
    return camera(metal - hole + 10, noise).astype(np.float64)


@pytest.mark.parametrize(
    "matrix",
    [
        similarity(-2, 1.0048, MIDDLE, (130.2, 131.9)),
        similarity(90, 0.9, MIDDLE, MIDDLE),
        similarity(180, 1.1, MIDDLE, (133.0, 129.1)),
        OBLIQUE,
    ],
    ids=["rig", "90 degrees", "180 degrees", "oblique"],
)
def test_transform_between_drawn_views(matrix: Array) -> None:
    """The transform is good to 0.1 px at the corners of the triangle of discs, which are found to 0.05 px at this
    noise.
    """
    target = np.concatenate([draw(TARGET, SHAPE), draw(moved(TARGET, matrix), SHAPE)], axis=1)
    frame_of_ring = np.concatenate([np.full(SHAPE, 20.0), ring(60.3)], axis=1)
    found = calibrate(camera(target, noise=1), frame_of_ring, VIEWS, hole_radius_mm=2.0)
    assert found.affine is not None
    corners = np.array([(disc.x, disc.y) for disc in TARGET])
    np.testing.assert_allclose(applied(found.affine.matrix, corners), applied(matrix, corners), atol=0.1)
    np.testing.assert_allclose(found.affine.matrix[:, :2], matrix[:, :2], atol=1.5e-3)  # 0.1 px over 70 px
    # Blur moves the edge of the hole by blur^2 / 2R = 0.005 px, and noise by as much: 3e-4 of 60 px allows 0.02 px.
    assert found.mm_per_px == pytest.approx(2.0 / 60.3, rel=3e-4)
    assert found.discs[0][0].radius_px == pytest.approx(np.sqrt(30 * 28), abs=0.1)


@settings(max_examples=60)
@given(
    degrees=st.floats(-180, 180),
    scale=st.floats(0.5, 2.0),
    order=st.permutations(range(3)),
    other=st.permutations(range(3)),
)
def test_labels_follow_from_the_shape_alone(degrees: float, scale: float, order: list[int], other: list[int]) -> None:
    """Discs are matched exactly for any rotation and scale, in any order in which they were found."""
    matrix = similarity(degrees, scale, MIDDLE, (300.0, -40.0))
    first, second = as_found(TARGET), as_found(moved(TARGET, matrix))
    pairs = match_discs([first[k] for k in order], [second[k] for k in other])
    for here, there in pairs:
        np.testing.assert_allclose(there.center, applied(matrix, np.array(here.center)), atol=1e-9)
    found = fit_affine([a.center for a, _ in pairs], [b.center for _, b in pairs])
    np.testing.assert_allclose(found.matrix, matrix, atol=1e-9)
    assert found.rms_px < 1e-9
    # Pairs begin with the largest disc and go clockwise: with y down, the turn from each disc to the next is positive.
    assert pairs[0][0].radius_px == pytest.approx(max(disc.radius_px for disc in first))
    places = np.array([b.center for _, b in pairs])
    a, b = places[1] - places[0], places[2] - places[0]
    assert a[0] * b[1] - a[1] * b[0] > 0


def test_a_mirrored_view_is_said_with_its_transform() -> None:
    with pytest.raises(FingerflowError, match="mirrored") as caught:
        match_discs(as_found(TARGET), as_found(moved(TARGET, MIRROR)))
    text = str(caught.value)
    matrix = tomllib.loads(text[text.index("topography_to_contact") : text.index("; where none")])
    np.testing.assert_allclose(matrix["topography_to_contact"], MIRROR, atol=1e-9)


def test_a_distractor_is_left_out() -> None:
    """A stain as dark and round as a disc is left out, in one view or elsewhere in both, even if it is the most
    significant.
    """
    stain, other = DrawnDisc(205.0, 215.0, 26, 26), DrawnDisc(35.0, 130.0, 34, 34)
    matrix = similarity(170, 1.05, MIDDLE, MIDDLE)
    for here, there in (((*TARGET, stain), moved(TARGET, matrix)), ((*TARGET, stain), (*moved(TARGET, matrix), other))):
        for order in permutations(range(len(there))):
            pairs = match_discs(as_found(here), [as_found(there)[k] for k in order])
            assert {pair[0].center for pair in pairs} == {(disc.x, disc.y) for disc in TARGET}
            for first, second in pairs:
                np.testing.assert_allclose(second.center, applied(matrix, np.array(first.center)), atol=1e-9)


@pytest.mark.parametrize(
    ("here", "there", "said"),
    [
        (TARGET, _OTHER, "no three discs form the same triangle.*Check the pixel ranges"),
        (_LINE, TARGET, r"\(40, 50\), \(100, 95\), \(160, 140\) px are collinear.*not on a line"),
        (_EVEN, _EVEN, r"more than one way.*different sizes"),
    ],
)
def test_discs_that_cannot_be_matched_are_said(here: Discs, there: Discs, said: str) -> None:
    """A triangle of equal sides and equal discs is refused too, because a turn by 120 degrees cannot be seen."""
    with pytest.raises(FingerflowError, match=said):
        match_discs(as_found(here), as_found(there))


def test_too_few_discs_in_a_frame_are_said_with_what_was_found() -> None:
    target = np.concatenate([draw(TARGET[:2], SHAPE), draw(TARGET, SHAPE)], axis=1)
    frame_of_ring = np.concatenate([np.full(SHAPE, 20.0), ring(60.3)], axis=1)
    with pytest.raises(FingerflowError, match=r"needs 3 discs.*topography view: 2 at \(x, y\) px .*contact view: 3 at"):
        calibrate(target, frame_of_ring, VIEWS)


def test_a_similarity_is_exact_and_no_reflection() -> None:
    source = np.random.default_rng(0).uniform(0, 200, (6, 2))
    matrix = similarity(133, 0.7, (10, 20), (3, 4))
    exact = fit_similarity(source, applied(matrix, source))
    np.testing.assert_allclose(exact.matrix, matrix, atol=1e-10)
    assert np.linalg.det(fit_similarity(source, applied(MIRROR, source)).matrix[:, :2]) > 0
    assert fit_similarity(source, applied(MIRROR, source)).rms_px > 10
    with pytest.raises(FingerflowError, match="coincide"):
        fit_similarity([(1, 2), (1, 2)], [(0, 0), (1, 1)])
    with pytest.raises(FingerflowError, match="lie on a line"):
        fit_affine([(0, 0), (1, 1), (2, 2)], [(0, 0), (1, 0), (0, 1)])
    with pytest.raises(FingerflowError, match=r"shapes \(2, 2\) and \(2, 2\).*at least 3"):
        fit_affine([(0, 0), (1, 0)], [(0, 0), (1, 0)])


def test_calibration_frames_that_cannot_be_are_refused() -> None:
    whole = {"contact": View((0, 256), (0, 272))}
    cases: list[tuple[str, dict[str, Any]]] = [
        ("'topography' is missing; views given: 'contact'", {"target": draw(TARGET)}),
        ("radius of the ring's hole is -1", {"hole_radius_mm": -1}),
        ("ring has 256 rows x 272 columns and that of the background 100 rows", {"background": np.zeros((100, 90))}),
        (r"\(256, 272, 3\)", {"ring": np.stack([ring(60)] * 3, axis=-1)}),
        ("does not fit into a frame of 256 rows and 272", {"views": {"contact": View((0, 512), (640, 1280))}}),
    ]
    for said, changed in cases:
        with pytest.raises(FingerflowError, match=said):
            calibrate(**({"target": None, "ring": ring(60), "views": whole} | changed))


@pytest.mark.parametrize("both", [True, False])
def test_a_calibration_file_is_read_as_it_was_written(both: bool, tmp_path: Path) -> None:
    matrix = similarity(12.3456789, 1 / 3, MIDDLE, MIDDLE)
    pairs = match_discs(as_found(TARGET), as_found(moved(TARGET, matrix)))
    points = [[pair[side].center for pair in pairs] for side in (0, 1)]
    written = Calibration(
        mm_per_px=0.1 + 0.2,
        hole_radius_mm=2.75,
        hole=pairs[0][0],
        views=VIEWS if both else {"contact": VIEWS["contact"]},
        discs=tuple(pairs) if both else (),
        affine=fit_affine(*points) if both else None,
        similarity=fit_similarity(*points) if both else None,
        warnings=('a "quoted" warning with \\ and µ', "another"),
    )
    path = tmp_path / "calibration.toml"
    path.write_text(written.to_toml(), encoding="utf-8")
    read, views = read_calibration(path)
    assert read["mm_per_px"] == written.mm_per_px
    assert views == {name: (view.rows, view.columns) for name, view in written.views.items()}
    assert np.array_equal(read.get("topography_to_contact"), written.affine and written.affine.matrix)
    table = tomllib.loads(written.to_toml())
    assert tuple(table["warnings"]) == written.warnings
    assert table["hole"] == {"radius_mm": 2.75, **json_value(pairs[0][0])}
    discs = [(pair["topography"], pair["contact"]) for pair in table.get("discs", [])]
    assert discs == [(json_value(one), json_value(other)) for one, other in written.discs]
    for name, transform in (("affine", written.affine), ("similarity", written.similarity)):
        if transform is not None:
            stored = table["topography_to_contact"][name]
            np.testing.assert_array_equal(stored["matrix"], transform.matrix)
            np.testing.assert_array_equal(stored["residuals_px"], transform.residuals_px)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("mm_per_px = 0.03", "mm_per_px = -0.03", "mm_per_px is -0.03: it should be above 0"),
        ("mm_per_px = 0.03", 'mm_per_px = "x"', "an entry of this calibration is wrong"),
        ("mm_per_px = 0.03", "", "no entry 'mm_per_px'"),
        ("mm_per_px = 0.03", "mm_per_px 0.03", "cannot be read"),
        ("rows = [0, 256]", "rows = [256, 0]", "rows is"),
        ("matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]", "matrix = [[1, 0, 0], [2, 0, 0]]", "onto a line"),
        ("matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]", "matrix = [[nan, 0, 0], [0, 1, 0]]", "finite number"),
    ],
)
def test_a_damaged_calibration_file_is_refused(old: str, new: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    identity = Transform(np.eye(2, 3), np.zeros((3, 2)))
    text = Calibration(0.03, 2.75, as_found(TARGET)[0], VIEWS, (), identity, identity).to_toml()
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(FingerflowError, match=said) as caught:
        read_calibration(path)
    assert str(path) in str(caught.value)
    assert "fingerflow calibrate" in str(caught.value)
