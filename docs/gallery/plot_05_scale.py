"""
How large is a pixel, and how is a view turned?
===============================================

A ring with a hole of known radius gives the scale, and three discs that both views show give the transform from the
topography view to the contact view. `fingerflow calibrate` does the same from two image files.
"""

import matplotlib.pyplot as plt
import numpy as np

from fingerflow.calibration import calibrate
from fingerflow.schema.views import View

# %%
# Two views side by side. The topography view is turned by 4 degrees and 2 % smaller than the contact view.

y, x = np.mgrid[:240, :240].astype(float)
radians, size = np.radians(4.0), 0.98
turn = size * np.array([[np.cos(radians), -np.sin(radians)], [np.sin(radians), np.cos(radians)]])
centre = np.array([120.0, 120.0])
discs = [((70.0, 80.0), 26.0), ((165.0, 75.0), 21.0), ((115.0, 170.0), 18.0)]


def draw(circles: list[tuple[tuple[float, float], float]]) -> np.ndarray:
    """Return a view (240, 240) with discs whose edges are one pixel wide."""
    inside = np.zeros_like(x)
    for (cx, cy), radius in circles:
        inside = np.maximum(inside, np.clip(radius - np.hypot(x - cx, y - cy) + 0.5, 0, 1))
    return 180 - 100 * inside


turned = [(tuple(centre + turn @ (np.array(at) - centre)), size * radius) for at, radius in discs]
target = np.hstack((draw(turned), draw(discs)))
ring = np.hstack((draw([]), draw([((121.3, 118.6), 84.6)])))
views = {"topography": View((0, 240), (0, 240)), "contact": View((0, 240), (240, 480))}

# %%
# The radius of the hole is 2.75 mm and 84.6 px.

found = calibrate(target, ring, views, hole_radius_mm=2.75)
angle = np.degrees(np.arctan2(found.similarity.matrix[1][0], found.similarity.matrix[0][0]))
print(f"{1e3 * found.mm_per_px:.3f} µm per px (true {1e3 * 2.75 / 84.6:.3f}), turned by {angle:.2f} degrees (true -4)")
assert abs(found.mm_per_px / (2.75 / 84.6) - 1) < 2e-3
assert abs(angle + 4) < 0.05

_, axes = plt.subplots(1, 2, figsize=(8, 2.4), layout="constrained")
for panel, frame, title in zip(axes, (target, ring), ("target in both views", "ring in the contact view"), strict=True):
    panel.imshow(frame, cmap="gray")
    panel.set_title(title)
    panel.axis("off")
