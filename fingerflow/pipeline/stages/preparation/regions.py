"""Masks of the regions of interest that a scene file defines in the views."""

import cv2
import numpy as np
from numpy.typing import NDArray

from fingerflow.errors import FingerflowError
from fingerflow.recordings.drawn_region import drawn_mask
from fingerflow.schema.scene import Scene


def region_mask(scene: Scene, name: str) -> NDArray[np.bool_] | None:
    """Return the mask (h, w) of the region of interest of a view; None if the scene defines none.

    Raises FingerflowError for a region without a pixel of the view, and for a mask image that cannot be read or has
    another size.
    """
    view = scene.views[name]
    if view.region is None:
        return None
    key = f"{scene.path}: views.{name}.region"
    mask = drawn_mask(view.region, view.shape)
    if (path := view.region.mask) is not None:
        picture = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_GRAYSCALE) if path.stat().st_size else None
        if picture is None:
            raise FingerflowError(f"{key}: {path} is no picture that can be read; save it as PNG")
        if picture.shape != view.shape:
            raise FingerflowError(
                f"{key}: {path} has {picture.shape[0]} x {picture.shape[1]} px, the view {view.shape[0]} x "
                f"{view.shape[1]}; draw it on the view, pixel by pixel"
            )
        mask = picture > 0
    if not mask.any():
        raise FingerflowError(
            f"{key} holds no pixel of the view of {view.shape[0]} x {view.shape[1]} px, counted from its own corner"
        )
    return mask
