"""Synthetic scenes of a finger on glass with exactly known motion, contact and forces: for demo, tests and bench."""

from fingerflow.synthetic.camera import Camera
from fingerflow.synthetic.chain_press import ChainPress
from fingerflow.synthetic.fingerprint import FingerprintTexture
from fingerflow.synthetic.linear_slip import LinearSlip
from fingerflow.synthetic.motion import Bump, Ellipse
from fingerflow.synthetic.partial_slip import PartialSlip
from fingerflow.synthetic.press import Press
from fingerflow.synthetic.scenes import SyntheticScene
from fingerflow.synthetic.skin_picture import PictureTexture, scene_of_print
from fingerflow.synthetic.slide import Slide
from fingerflow.synthetic.texture import RidgeTexture, texture_image
from fingerflow.synthetic.truth import Medians, Truth
from fingerflow.synthetic.writer import rebuild_scene, write_recording

__all__ = [
    "Bump", "Camera", "ChainPress", "Ellipse", "FingerprintTexture", "LinearSlip", "Medians", "PartialSlip",
    "PictureTexture", "Press", "RidgeTexture", "Slide", "SyntheticScene", "Truth", "rebuild_scene",
    "scene_of_print", "texture_image", "write_recording",
]  # fmt: skip
