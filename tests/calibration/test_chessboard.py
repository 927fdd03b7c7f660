"""Tests of the lens that a chessboard shows, and of the calibration with it, on frames drawn through a known lens."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from fingerflow.calibration import calibrate_files
from fingerflow.errors import FingerflowError
from fingerflow.recordings import open_recording
from fingerflow.recordings.lens import Lens
from fingerflow.schema.calibration_file import read_calibration
from fingerflow.schema.views import View
from fingerflow.view.draft import Draft
from fingerflow.view.session import Session
from tests.calibration.drawn_discs import DrawnDisc, camera, draw, moved, similarity

_SHAPE = (360, 800)
VIEWS = {"topography": View((0, 360), (0, 400)), "contact": View((0, 360), (400, 800))}
_MATRIX = similarity(2.0, 1.02, (200.0, 180.0), (203.0, 176.0))
_ON_TOPOGRAPHY = (DrawnDisc(70, 70, 30, 30), DrawnDisc(320, 90, 22, 22), DrawnDisc(110, 300, 23, 23))
_RADIUS_PX, _RADIUS_MM = 75.0, 2.75
_CORNERS = (13, 11)
_FOCAL = float(np.hypot(*_SHAPE)) / 2
_PIXELS = np.stack(np.meshgrid(np.arange(400.0), np.arange(360.0)), -1)  # (x, y) in a view


def _lens(k1: float, k2: float = 0.0, p1: float = 0.0, p2: float = 0.0) -> Lens:
    return Lens((_FOCAL, _FOCAL, 399.5, 179.5), (k1, k2, p1, p2, 0.0))


def _frames(folder: Path, lens: Lens) -> dict[str, Path]:
    """Write frames of a chessboard in both views, of the target and of the ring (in the contact view)."""
    flat = np.full((360, 400), 120.0)
    target = draw(_ON_TOPOGRAPHY, flat.shape), draw(moved(_ON_TOPOGRAPHY, _MATRIX), flat.shape)
    ring = flat, draw((DrawnDisc(300, 240, _RADIUS_PX, _RADIUS_PX),), flat.shape)
    turned = _PIXELS @ ((1.0, 0.02), (-0.02, 1.0)) - (40.0, 45.0)
    squares = 120 + 60 * np.tanh(6 * np.sin(np.pi * turned / 24).prod(-1))
    pictures = {"chessboard": (_bounded(squares, turned), _bounded(squares, turned)), "target": target, "ring": ring}
    for name, parts in pictures.items():
        seen = [_through(lens, part, view) for part, view in zip(parts, VIEWS.values(), strict=True)]
        tifffile.imwrite(folder / f"{name}.tif", camera(np.concatenate(seen, axis=1), 1.0))
    return {name: folder / f"{name}.tif" for name in pictures}


def _bounded(squares: NDArray[np.float64], position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a board of 14 x 12 squares on white."""
    return np.where(((position > 0) & (position < (14 * 24, 12 * 24))).all(-1), squares, 180.0)


def _through(lens: Lens, picture: NDArray[np.float64], view: View) -> NDArray[np.float64]:
    column, row = np.moveaxis(lens.straighten(_PIXELS, view).astype(np.float32), -1, 0)
    return cv2.remap(picture, column, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


@pytest.mark.parametrize(
    ("lens", "by_page"),
    [(_lens(0.01), False), pytest.param(_lens(-0.04, 0.01, 0.002, -0.003), True, marks=pytest.mark.long)],
)
def test_scale_transform_and_lens_come_from_frames_through_the_lens(lens: Lens, by_page: bool, tmp_path: Path) -> None:
    files, output = _frames(tmp_path, lens), tmp_path / "rig.toml"
    calibrated = calibrate_files(
        files["ring"], files["target"], views=VIEWS, output=output, chessboard=files["chessboard"], corners=_CORNERS
    )
    assert calibrated.lens is not None
    assert calibrated.affine is not None
    # The board ends 40 px before the edge of the view.
    grid = np.stack(np.meshgrid(np.linspace(0, 399, 9), np.linspace(0, 359, 9)), -1)
    for view in VIEWS.values():
        np.testing.assert_allclose(calibrated.lens.straighten(grid, view), lens.straighten(grid, view), atol=0.6)
    assert calibrated.mm_per_px == pytest.approx(_RADIUS_MM / _RADIUS_PX, rel=1e-3)
    np.testing.assert_allclose(calibrated.affine.matrix[:, :2], _MATRIX[:, :2], atol=2e-3)
    raw = calibrate_files(files["ring"], views={"contact": VIEWS["contact"]}, output=tmp_path / "raw.toml")
    assert abs(raw.mm_per_px * _RADIUS_PX / _RADIUS_MM - 1) > 2e-3
    if by_page:
        page, output = Session(Draft.create(open_recording(files["ring"])), None), tmp_path / "calibration.toml"
        page.calibrate(corners=[*_CORNERS], **{name: file.name for name, file in files.items()})
    stored, _ = read_calibration(output)
    assert stored["intrinsics"] == list(calibrated.lens.intrinsics)
    assert stored["distortion"] == list(calibrated.lens.distortion)


def test_a_frame_without_the_chessboard_is_refused(tmp_path: Path) -> None:
    files = _frames(tmp_path, _lens(0.01))
    for changes, message in (
        ({"chessboard": files["ring"], "corners": _CORNERS}, "shows a chessboard with 13 x 11 inner corners"),
        ({"chessboard": files["chessboard"], "corners": (0, 0)}, "chessboard and corners belong together"),
        ({"corners": _CORNERS}, "chessboard and corners belong together"),
    ):
        with pytest.raises(FingerflowError, match=message):
            calibrate_files(files["ring"], views={"contact": VIEWS["contact"]}, output=tmp_path / "rig.toml", **changes)
