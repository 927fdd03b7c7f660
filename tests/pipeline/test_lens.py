"""Tests of the correction for the lens, on a press whose frames are recorded through a lens that distorts."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

from fingerflow import load_scene, process
from fingerflow.errors import FingerflowError
from fingerflow.kernels.library import is_present
from fingerflow.kernels.result_records import FrameContact
from fingerflow.recordings.lens import Geometry, Lens
from fingerflow.schema.scene_tables import CalibrationSettings
from fingerflow.schema.views import View
from fingerflow.tracker.sizes_on_glass import SizesOnGlass
from tests.silent.case import played
from tests.small_trials import SMALL_PRESS, edit, write_small

SIZES = ["real_contact_area", "gross_contact_area", "ellipse_center", "ellipse_semi_axes"]
_ROWS, _COLUMNS = SMALL_PRESS.frame_shape
_CENTRE = (_COLUMNS / 2 - 0.5, _ROWS / 2 - 0.5)
_RADIUS = float(np.hypot(*_CENTRE))  # px, from the principal point to a corner: with it as focal length k1 is the
#: distortion at the corner.
LENSES = {
    "barrel": Lens((_RADIUS, _RADIUS, *_CENTRE), (-0.05, 0.01, 0.0, 0.0, 0.0)),
    "pincushion": Lens((_RADIUS, _RADIUS, *_CENTRE), (0.03, 0.0, 0.0, 0.0, 0.005)),
    "decentred": Lens((_RADIUS, _RADIUS, _CENTRE[0] + 20, _CENTRE[1] - 9), (-0.02, 0.0, 0.004, -0.003, 0.0)),
    "tall pixels": Lens((_RADIUS, 0.96 * _RADIUS, *_CENTRE), (0.0, 0.0, 0.0, 0.0, 0.0)),
}


def _model(lens: Lens, straight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return recorded px of the frame, of straight ones as wide as high, by the equations of OpenCV's manual."""
    fx, fy, cx, cy = lens.intrinsics
    k1, k2, p1, p2, k3 = lens.distortion
    x, y = np.moveaxis((straight - (cx, cy)) / fx, -1, 0)
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    across = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    down = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack((fx * across + cx, fy * down + cy), -1)


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_positions_follow_the_model(lens: Lens) -> None:
    view = View((10, _ROWS), (_COLUMNS // 2, _COLUMNS))
    straight = np.random.default_rng(0).uniform((_COLUMNS / 2, 10), (_COLUMNS - 1, _ROWS - 1), (50, 2))
    recorded = _model(lens, straight) - (view.columns[0], view.rows[0])
    found = lens.straighten(recorded, view)
    np.testing.assert_allclose(np.diff(found, axis=0), np.diff(straight, axis=0), atol=1e-6)
    np.testing.assert_allclose(lens.distort(found, view), recorded, atol=1e-6)
    centre = (np.array(view.shape[::-1]) - 1) / 2
    np.testing.assert_allclose(lens.straighten(centre, view), centre, atol=1e-9)
    assert np.isnan(lens.straighten(np.full((2, 2), np.nan), view)).all()


@pytest.mark.parametrize(("k1", "fx"), [(-1.0, _RADIUS), (-0.5, 150.0), (np.float64(-40.0), 500.0)])
def test_a_lens_that_folds_the_view_is_refused(k1: float, fx: float) -> None:
    with pytest.raises(FingerflowError, match="fold the view with rows"):
        Lens((fx, fx, *_CENTRE), (k1, 0.0, 0.0, 0.0, 0.0)).check(View((0, _ROWS), (0, _COLUMNS // 2)))


def _record_through(lens: Lens, ideal: Path, folder: Path) -> Path:
    """Write the recording `ideal` as it is recorded through a lens; return the path of its scene file."""
    folder.mkdir()
    views = [View((0, _ROWS), (0, _COLUMNS // 2)), View((0, _ROWS), (_COLUMNS // 2, _COLUMNS))]
    y, x = np.mgrid[:_ROWS, : _COLUMNS // 2].astype(np.float64)
    maps = [np.moveaxis(lens.straighten(np.stack((x, y), -1), view).astype(np.float32), -1, 0) for view in views]
    for file in ideal.iterdir():
        if file.suffix != ".npy":
            (folder / file.name).write_bytes(file.read_bytes())
            continue
        frames = [
            np.concatenate(
                [
                    cv2.remap(view.crop(frame), *straight, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
                    for view, straight in zip(views, maps, strict=True)
                ],
                axis=1,
            )
            for frame in np.load(file).reshape(-1, _ROWS, _COLUMNS)
        ]
        np.save(folder / file.name, np.stack(frames))
    return folder / "scene.toml"


def _with_lens(scene: Path, lens: Lens) -> Path:
    stated = f"intrinsics = {list(lens.intrinsics)}\ndistortion = {list(lens.distortion)}\nmm_per_px ="
    edit(scene, ("mm_per_px =", stated))
    return scene


@pytest.fixture(scope="module")
def ideal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small(tmp_path_factory.mktemp("lens") / "ideal", SMALL_PRESS)


def _position_error(result: xr.Dataset) -> float:
    """Return the median error of displacements since the first frame, mm, from the exact truth of the press."""
    truth, position = SMALL_PRESS.truth, result["position"].values
    tracked = (result["status"].values == 0).all(0) & np.isfinite(position).all((0, 2))
    first, last = position[0, tracked], position[-1, tracked]
    expected = truth.positions(truth.material(first, 0), len(position) - 1)
    return float(np.median(np.hypot(*(last - expected).T)))


@pytest.mark.parametrize("name", ["barrel", "pincushion", "tall pixels"])
def test_a_press_through_a_lens_is_measured_as_without(name: str, ideal: Path, tmp_path: Path) -> None:
    scene = _record_through(LENSES[name], ideal.parent, tmp_path / "seen")
    outputs = ["gross_contact_area", "ellipse_center", "position", "status"]
    true, raw = process(ideal, outputs), process(scene, outputs)
    right = process(_with_lens(scene, LENSES[name]), outputs)
    errors = [
        abs(float(result["gross_contact_area"][-1] / true["gross_contact_area"][-1]) - 1) for result in (right, raw)
    ]
    assert errors[0] < 0.015 < 0.03 < errors[1]
    assert _position_error(right) < 0.002 < 0.0025 < _position_error(raw)
    np.testing.assert_allclose(right["ellipse_center"][-1], true["ellipse_center"][-1], atol=0.028)


@pytest.mark.skipif(not is_present(), reason="the compiled library was not built or is turned off")
def test_a_stream_is_corrected_as_a_recording_is(ideal: Path, tmp_path: Path) -> None:
    """Sizes are equal to float32, positions where a stream tracks the same points to rounding."""
    scene = _with_lens(_record_through(LENSES["barrel"], ideal.parent, tmp_path / "seen"), LENSES["barrel"])
    edit(scene, ('threshold = "reference_frame"', "threshold = 0.27"))
    recorded = process(scene, SIZES)
    stream, settings = played(scene), load_scene(scene)
    for name in SIZES:
        np.testing.assert_allclose(stream[name], recorded[name], rtol=1e-6, err_msg=name)
    geometry = Geometry(settings.calibration, settings.views.contact, settings.views.topography)
    np.testing.assert_allclose(stream["position"], geometry.on_glass(stream["position_px"].values), rtol=1e-12)


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_areas_and_ellipses_are_those_of_the_straight_outline(lens: Lens) -> None:
    view, cell, turn = View((0, _ROWS), (_COLUMNS // 2, _COLUMNS)), 4, np.linspace(0, 2 * np.pi, 400, endpoint=False)
    center, axes, angle = np.array([140.0, 100.0]), np.array([80.0, 60.0]), 0.4
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    outline = center + np.column_stack((np.cos(turn), np.sin(turn))) * axes @ rotation.T
    y, x = np.mgrid[cell / 2 - 0.5 : _ROWS : cell, cell / 2 - 0.5 : _COLUMNS / 2 : cell]
    inside = (((np.stack((x, y), -1) - center) @ rotation / axes) ** 2).sum(-1) < 1
    contact = FrameContact(
        None, np.zeros(1), np.zeros(1), center[None], axes[None], np.array([angle]), 2.0 * inside[None, None] - 1
    )
    calibration = CalibrationSettings(mm_per_px=0.5, intrinsics=lens.intrinsics, distortion=lens.distortion)
    sizes = SizesOnGlass(Geometry(calibration, view, None), cell).sizes(contact)
    straight = lens.straighten(outline, view).astype(np.float32)
    area = cv2.contourArea(straight) / cv2.contourArea(outline.astype(np.float32))
    (_, expected, degrees), moments = cv2.fitEllipse(straight), cv2.moments(straight)
    assert float(sizes.pixel[0]) == pytest.approx(0.25 * area, rel=1e-3)
    middle = (moments["m10"] / moments["m00"], moments["m01"] / moments["m00"])
    np.testing.assert_allclose(2 * sizes.ellipse.center[0], middle, atol=0.1)
    np.testing.assert_allclose(2 * sizes.ellipse.semi_axes[0], np.array(expected)[::-1] / 2, rtol=5e-3)
    assert abs((sizes.ellipse.angle[0] - np.radians(degrees + 90) + np.pi / 2) % np.pi - np.pi / 2) < 0.01
