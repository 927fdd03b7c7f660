"""Images of the views of a frame, with contact, points and displacement drawn over them."""

from typing import Any

import cv2
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fingerflow.plot.outlines import contact_outline, matrix_of_view, stuck_outline, to_pixels
from fingerflow.plot.picture import check_recording, shown_views
from fingerflow.recordings import Recording
from fingerflow.schema.scene import Scene

Picture = NDArray[np.uint8]
_OUTLINED = ("ellipse_center", "ellipse_semi_axes", "ellipse_angle", "stuck_region")
STUCK = (255, 0, 200)
CONTACT, TRACKED, LOST, ARROW = (80, 200, 255), (120, 255, 120), (255, 80, 80), (255, 210, 60)
_ARROW_OPACITY = 0.7  # opacity of arrows, so that the skin stays visible below


class ViewPainter:
    """Painter of contact, points and displacement over the views of a frame; colours are RGB."""

    def __init__(self, result: xr.Dataset, scene: Scene, recording: Recording) -> None:
        """Prepare to paint the frames of a recording with their result; raise FingerflowError if the result was
        computed from another recording.
        """
        first, last = scene.recording.first_frame, scene.recording.last_frame
        self._frames = recording[first : len(recording) if last is None else last + 1]
        check_recording(result, self._frames)
        self._result = result
        self._outlined = result[[name for name in _OUTLINED if name in result]]
        self._views = [(scene.views[name], matrix_of_view(result, name)) for name in shown_views(scene)]
        self._levels: dict[int, tuple[float, float]] = {}

    def paint(self, frame: int, arrow_scale: float = 0.0) -> Picture:
        """Return an RGB image (H, W, 3) of a frame, by its index in the result: its views side by side, with contact,
        points, and displacement arrows lengthened by `arrow_scale` (0: no arrows).
        """
        picture, outlined = self._frames[frame], self._outlined.isel(frame=frame, missing_dims="ignore")
        outlines = ((contact_outline(outlined), CONTACT, 1), (stuck_outline(outlined), STUCK, 2))
        parts = []
        for number, (view, matrix) in enumerate(self._views):
            part = self._grey(number, view.crop(picture))
            for outline, colour, width in outlines:
                if outline is not None:
                    cv2.polylines(part, [_drawing_coordinates(outline, matrix)], True, colour, width, cv2.LINE_AA, 3)
            self._points(part, frame, matrix, arrow_scale)
            parts.append(part)
        height = min(part.shape[0] for part in parts)
        return np.ascontiguousarray(np.concatenate([part[:height] for part in parts], axis=1))

    def _grey(self, number: int, picture: NDArray[Any]) -> Picture:
        part = picture.astype(np.float32)
        if number not in self._levels:
            # Use the contrast of the first painted frame for all frames, so that a video does not flicker.
            self._levels[number] = (float(np.percentile(part, 0.5)), float(np.percentile(part, 99.8)))
        low, high = self._levels[number]
        grey = np.clip((part - low) * (255 / max(high - low, 1e-6)), 0, 255).astype(np.uint8)
        return cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)

    def _points(self, part: Picture, frame: int, matrix: NDArray[np.float64], arrow_scale: float) -> None:
        if "position" not in self._result:
            return
        positions = self._result["position"].values
        tracked = np.isfinite(positions[frame]).all(-1)
        now = _drawing_coordinates(positions[frame], matrix)
        if "displacement" in self._result and arrow_scale:
            moved = self._result["displacement"].values[frame]
            shown = tracked & np.isfinite(moved).all(-1)
            tips = _drawing_coordinates(positions[frame] + arrow_scale * moved, matrix)
            arrows = part.copy()
            cv2.polylines(arrows, list(np.stack((now, tips), axis=1)[shown]), False, ARROW, 1, cv2.LINE_AA, 3)
            cv2.addWeighted(arrows, _ARROW_OPACITY, part, 1 - _ARROW_OPACITY, 0, dst=part)
        lost = ~tracked & np.isfinite(positions[0]).all(-1)
        for drawn, colour in ((now[tracked], TRACKED), (_drawing_coordinates(positions[0], matrix)[lost], LOST)):
            for position in drawn.tolist():
                cv2.circle(part, position, 14, colour, -1, cv2.LINE_AA, 3)


def _drawing_coordinates(millimetres: NDArray[np.float64], matrix: NDArray[np.float64]) -> NDArray[np.int32]:
    """Convert positions (N, 2), mm on the glass, by the affine map `matrix` (2, 3) to px of a view, as integers in 1/8
    px, which OpenCV draws; arbitrary where NaN.
    """
    return np.round(np.nan_to_num(to_pixels(millimetres, matrix)) * 8).astype(np.int32)
