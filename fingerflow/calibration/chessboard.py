"""Measurement of the distortion of a lens from a chessboard."""

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import ArrayLike

from fingerflow.errors import FingerflowError
from fingerflow.recordings.lens import Lens
from fingerflow.schema.views import View

_FLAGS = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_FOCAL_LENGTH | cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_K3
MOST_RMS_PX = 0.3  # of the corners after the fit


def fit_lens(frame: ArrayLike, views: Mapping[str, View], corners: tuple[int, int]) -> Lens:
    """Return the lens that makes the rows and columns of a chessboard straight in all views that show it.

    Pixels are taken for square. A board that lies flat on the glass does not determine the focal length: that of the
    lens is half the diagonal of the frame, so that k1 is about the relative distortion at its corners.

    Args:
        frame: (H, W), with one chessboard in each view, or in one of them.
        corners: numbers of inner corners in a row and in a column of the board.

    Raises:
        FingerflowError: no view shows all corners, or they are not straight even so.
    """
    levels = np.asarray(frame, dtype=np.float64)
    grey = (255 * (levels - levels.min()) / max(np.ptp(levels), 1e-9)).astype(np.uint8)
    seen = []
    for view in views.values():
        complete, pixels = cv2.findChessboardCornersSB(view.crop(grey), corners, flags=cv2.CALIB_CB_ACCURACY)
        if complete:
            seen.append(pixels.astype(np.float32) + np.array([view.columns[0], view.rows[0]], np.float32))
    if not seen:
        raise FingerflowError(
            f"no view ({', '.join(views)}) shows a chessboard with {corners[0]} x {corners[1]} inner corners: count "
            f"those between squares, and record the whole board with a bright margin"
        )
    height, width = grey.shape
    board = np.zeros((corners[0] * corners[1], 3), np.float32)
    board[:, :2] = np.mgrid[: corners[0], : corners[1]].T.reshape(-1, 2)
    focal, centre = float(np.hypot(width, height)) / 2, ((width - 1) / 2, (height - 1) / 2)
    matrix = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
    rms, _, fitted, *_ = cv2.calibrateCamera(
        [board] * len(seen), seen, (width, height), matrix, np.zeros(5), flags=_FLAGS
    )
    if not rms < MOST_RMS_PX:
        raise FingerflowError(
            f"the corners of the chessboard are {rms:.2f} px off those of a flat board seen through a lens, and at "
            f"most {MOST_RMS_PX} px are allowed: is it flat on the glass, sharp and lit evenly?"
        )
    k1, k2, p1, p2, k3 = (float(value) for value in fitted.ravel()[:5])
    return Lens((focal, focal, *centre), (k1, k2, p1, p2, k3))
