"""Scenes of a finger on glass with exactly known motion, contact and forces: for the demo, the tests and the bench."""

from fingerflow.synthetic.texture import RidgeTexture, texture_image

__all__ = ["RidgeTexture", "texture_image"]
