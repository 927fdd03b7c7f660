"""Calibrate a rig (image scale and transform between views) from frames of a disc target and of a scale ring."""

from fingerflow.calibration.calibration import Calibration, is_calibration
from fingerflow.calibration.chessboard import fit_lens
from fingerflow.calibration.discs import find_discs, find_hole
from fingerflow.calibration.edge import Disc
from fingerflow.calibration.from_files import FILE, calibrate_files
from fingerflow.calibration.from_frames import calibrate
from fingerflow.calibration.overlay_image import draw_overlay
from fingerflow.calibration.registration import Transform, fit_affine, fit_similarity, match_discs

__all__ = [
    "FILE", "Calibration", "Disc", "Transform", "calibrate", "calibrate_files", "draw_overlay", "find_discs",
    "find_hole", "fit_affine", "fit_lens", "fit_similarity", "is_calibration", "match_discs",
]  # fmt: skip
