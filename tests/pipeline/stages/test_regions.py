"""Tests of regions drawn in the views: their pixels, the contact and the points inside them, and refused regions."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from matplotlib.path import Path as Outline

from fingerflow import process
from fingerflow.errors import FingerflowError, PlayerError
from fingerflow.pipeline.stages.preparation.inputs import region_mask
from fingerflow.player.stream_scene import load_scene as load_stream
from fingerflow.player.stream_scene import stream_settings
from fingerflow.recordings.drawn_region import drawn_mask
from fingerflow.schema.scene import Scene
from fingerflow.schema.views import DrawnEllipse, Region

POINTS = "points = 700"
CONTACT, TOPOGRAPHY = "[views.contact]", "[views.topography]"


@pytest.fixture
def drawn(changed: Callable[..., Scene]) -> Callable[..., Scene]:
    """Return a function that draws a region in a view of the press, without the stream's rectangle:
    ``drawn("[views.contact]", "polygon = [...]")``.
    """

    def draw(table: str, region: str, replaced: dict[str, str] | None = None) -> Scene:
        return changed({table: f"{table}\nregion = {{{region}}}", **(replaced or {})}, stream=False)

    return draw


@pytest.mark.parametrize("seed", range(5))
def test_a_region_holds_the_pixels_whose_centres_it_holds(seed: int) -> None:
    """A polygon contains the same pixel centres as by matplotlib, an ellipse those of its formula; corners are not
    integers, so no centre lies on a side.
    """
    random = np.random.default_rng(seed)
    turn = np.sort(random.uniform(0, 2 * np.pi, 9))
    corners = np.stack([np.cos(turn), np.sin(turn)], 1) * random.uniform(5, 40, (9, 1)) + [37.3, 24.6]
    x, y = np.meshgrid(np.arange(80), np.arange(50))
    expected = Outline(corners).contains_points(np.stack([x.ravel(), y.ravel()], 1)).reshape(50, 80)
    polygon = Region(polygon=tuple((x, y) for x, y in corners.tolist()))
    np.testing.assert_array_equal(drawn_mask(polygon, (50, 80)), expected)
    x, y, angle = x - 41.3, y - 30.2, seed - 2.1
    along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    found = drawn_mask(Region(ellipse=DrawnEllipse((41.3, 30.2), (38.0, 17.0), angle)), (50, 80))
    np.testing.assert_array_equal(found, (along / 38) ** 2 + (across / 17) ** 2 <= 1)


def test_contact_counts_inside_its_region_alone(
    changed: Callable[..., Scene], drawn: Callable[..., Scene], frames: np.ndarray[Any, Any]
) -> None:
    """The contact areas of two half views add up to the whole to 2 %; the median filter of 3 x 3 px differs where the
    border cuts ridges. What darkens the other half does not choose the frame with most contact.
    """
    fixed = {'threshold = "reference_frame"': "threshold = 0.25"}
    scene = changed(fixed)
    height, width = scene.views.contact.shape
    middle = width / 2 + 0.5
    names = ["real_contact_area"]
    whole = process(scene, names)["real_contact_area"].values
    halves = []
    for first, end in ((0, middle), (middle, width)):
        corners = [[first, 0], [end, 0], [end, height], [first, height]]
        halves.append(process(drawn(CONTACT, f"polygon = {corners}", fixed), names)["real_contact_area"].values)
    assert min(half[-1] for half in halves) > 0.2 * whole[-1]
    np.testing.assert_allclose(halves[0] + halves[1], whole, rtol=0.02, atol=1e-3)
    spoilt = frames.copy()
    scene.views.contact.crop(spoilt)[0, :, :50] //= 3
    half = changed({CONTACT: f"{CONTACT}\nregion = {{polygon = {corners}}}"}, stream=False, forces=False, frames=spoilt)
    np.testing.assert_allclose(process(half, names)["real_contact_area"], halves[1], rtol=0.2)


def test_points_are_chosen_in_the_region_by_process_and_stream_alike(drawn: Callable[..., Scene]) -> None:
    ellipse = "ellipse = {center = [60, 48], semi_axes = [30, 22], angle = 0.4}"
    scene = drawn(TOPOGRAPHY, ellipse, {POINTS: "points = 60"})
    mask = region_mask(scene, "topography")
    assert mask is not None
    bundle: Any = SimpleNamespace(height=mask.shape[0], width=mask.shape[1], points=60, bit_depth=8)
    np.testing.assert_array_equal(stream_settings(load_stream(scene.path), bundle).region, mask)
    first = process(scene, ["position_px"])["position_px"].values[0]
    x, y = first[np.isfinite(first).all(1)].round().astype(int).T  # more points are seeded later, as the contact grows
    assert len(x) > 20
    assert mask[y, x].all()


def test_a_picture_is_a_region_and_what_does_not_fit_is_refused(
    changed: Callable[..., Scene], drawn: Callable[..., Scene], tmp_path: Path
) -> None:
    picture = np.zeros(changed().views.contact.shape, np.uint8)
    picture[10:30, 20:50] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), picture)
    scene = drawn(CONTACT, 'mask = "mask.png"')
    found = region_mask(scene, "contact")
    assert found is not None
    np.testing.assert_array_equal(found, picture > 0)
    assert tmp_path / "mask.png" in scene.files()
    with pytest.raises(PlayerError, match=r"views\.topography\.region is a picture.*polygon or an ellipse"):
        load_stream(drawn(TOPOGRAPHY, 'mask = "mask.png"').path)
    with pytest.raises(PlayerError, match=r"views\.contact\.region is of `fingerflow process`.*rows and columns"):
        load_stream(drawn(CONTACT, "polygon = [[0, 0], [90, 0], [90, 90]]").path)
    with pytest.raises(FingerflowError, match=r"views\.contact\.region holds no pixel of the view of"):
        region_mask(drawn(CONTACT, "polygon = [[900, 0], [990, 0], [990, 90]]"), "contact")
    cv2.imwrite(str(tmp_path / "mask.png"), np.ones((7, 9), np.uint8))
    with pytest.raises(FingerflowError, match=r"mask\.png has 7 x 9 px"):
        region_mask(scene, "contact")
    with pytest.raises(FingerflowError, match=r"both say where points are chosen"):
        changed({TOPOGRAPHY: f"{TOPOGRAPHY}\nregion = {{polygon = [[0, 0], [90, 0], [90, 90]]}}"})
