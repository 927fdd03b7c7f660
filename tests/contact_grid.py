"""Skin all over the contact of a scene, for what is compared with truth by its area."""

import numpy as np
import torch

from fingerflow.synthetic.scenes import Scene


def skin_in_contact(scene: Scene, frame: int, step_mm: float) -> np.ndarray:
    """(N, 2) mm, material of a grid over the contact in a frame."""
    ellipse = scene.truth.ellipse(frame)
    assert ellipse is not None
    axis = np.arange(-6, 6, step_mm)
    places = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2) + ellipse.centre
    inside = (ellipse.distance(*torch.from_numpy(places).unbind(-1)) > 0).numpy()
    return np.asarray(scene.truth.material(places[inside], frame))
