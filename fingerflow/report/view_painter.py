"""Images of the views of a frame, with contact, points and displacement drawn over them."""

import json
from typing import Any

import cv2
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from fingerflow.plot.outlines import stuck_outline
from fingerflow.plot.picture import check_recording
from fingerflow.recordings import Recording
from fingerflow.schema.scene import Scene
from fingerflow.schema.views import View

Picture = NDArray[np.uint8]
STUCK = (255, 0, 200)
CONTACT, TRACKED, LOST, ARROW = (80, 200, 255), (120, 255, 120), (255, 80, 80), (255, 210, 60)


class ViewPainter:
    """Painter of contact, points and displacement over the views of a frame; colours are RGB."""

    def __init__(self, result: xr.Dataset, scene: Scene, recording: Recording) -> None:
        """Check that the result was computed from this recording; raise FingerflowError otherwise."""
        check_recording(result, scene, recording)
        self._result = result
        self._scene = scene
        self._recording = recording
        self._size = float(result.attrs["mm_per_px"])
        matrix = np.vstack((np.array(json.loads(result.attrs["topography_to_contact"])), (0, 0, 1)))
        self._to_topography = np.linalg.inv(matrix)[:2]
        self._levels: dict[str, tuple[float, float]] = {}
        self._first = scene.recording.first_frame

    def paint(self, frame: int, arrow_scale: float = 0.0) -> Picture:
        """Return an image (H, W, 3) of the views side by side in a frame, given by its index in the result."""
        picture = self._recording[self._first + frame]
        parts = []
        views = {"topography": self._scene.views.topography, "contact": self._scene.views.contact}
        if self._scene.soft_sensor:
            views = {"contact": self._scene.views["camera"]}  # its other views show the same picture
        for name, view in views.items():
            if view is not None:
                part = self._grey(name, picture, view)
                matrix = self._to_topography if name == "topography" else np.array([[1.0, 0, 0], [0, 1.0, 0]])
                self._ellipse(part, frame, matrix)
                self._stuck(part, frame, matrix)
                self._points(part, frame, matrix, arrow_scale)
                parts.append(part)
        height = min(part.shape[0] for part in parts)
        return np.ascontiguousarray(np.concatenate([part[:height] for part in parts], axis=1))

    def _grey(self, name: str, picture: NDArray[Any], view: View) -> Picture:
        part = view.crop(picture).astype(np.float32)
        if name not in self._levels:
            # One contrast for all frames, from the first one drawn, so that a video does not flicker.
            self._levels[name] = (float(np.percentile(part, 0.5)), float(np.percentile(part, 99.8)))
        low, high = self._levels[name]
        grey = np.clip((part - low) * (255 / max(high - low, 1e-6)), 0, 255).astype(np.uint8)
        result: Picture = cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)
        return result

    def _ellipse(self, part: Picture, frame: int, matrix: NDArray[np.float64]) -> None:
        if "ellipse_angle" not in self._result:
            return
        center = self._result["ellipse_center"].values[frame]
        axes = self._result["ellipse_semi_axes"].values[frame]
        angle = float(self._result["ellipse_angle"].values[frame])
        if not np.isfinite(angle):
            return
        turn = np.linspace(0, 2 * np.pi, 120)
        along, beside = axes[0] * np.cos(turn), axes[1] * np.sin(turn)
        x = center[0] + along * np.cos(angle) - beside * np.sin(angle)
        y = center[1] + along * np.sin(angle) + beside * np.cos(angle)
        outline = self._eighths(np.stack((x, y), axis=1), matrix)
        cv2.polylines(part, [outline], True, CONTACT, 1, cv2.LINE_AA, 3)

    def _stuck(self, part: Picture, frame: int, matrix: NDArray[np.float64]) -> None:
        if "stuck_region" not in self._result:
            return
        region = self._result["stuck_region"]
        outline = stuck_outline(region[frame].values, region.attrs["cell_mm"], region.attrs["first_cell_mm"])
        if outline is not None:
            cv2.polylines(part, [self._eighths(outline, matrix)], True, STUCK, 2, cv2.LINE_AA, 3)

    def _points(self, part: Picture, frame: int, matrix: NDArray[np.float64], arrow_scale: float) -> None:
        if "position" not in self._result:
            return
        positions = self._result["position"].values
        known = np.isfinite(positions[frame]).all(-1)
        now = self._eighths(positions[frame], matrix)
        if "displacement" in self._result and arrow_scale:
            moved = self._result["displacement"].values[frame]
            shown = known & np.isfinite(moved).all(-1)
            tips = self._eighths(positions[frame] + arrow_scale * moved, matrix)
            cv2.polylines(part, list(np.stack((now, tips), axis=1)[shown]), False, ARROW, 1, cv2.LINE_AA, 3)
        lost = ~known & np.isfinite(positions[0]).all(-1)
        for places, colour in ((now[known], TRACKED), (self._eighths(positions[0], matrix)[lost], LOST)):
            for place in places.tolist():
                cv2.circle(part, place, 10, colour, -1, cv2.LINE_AA, 3)

    def _eighths(self, millimetres: NDArray[np.float64], matrix: NDArray[np.float64]) -> NDArray[np.int32]:
        """Convert positions (N, 2) px to integers in eighths of a pixel for OpenCV; arbitrary for unknown positions."""
        return np.round(np.nan_to_num(self._pixels(millimetres, matrix)) * 8).astype(np.int32)

    def _pixels(self, millimetres: NDArray[np.float64], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
        result: NDArray[np.float64] = millimetres / self._size @ matrix[:, :2].T + matrix[:, 2]
        return result
