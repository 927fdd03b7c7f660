"""
Where does the skin spread?
===========================

A map of the divergence: the relative change of area of the skin in contact since each point touched. Hundreds of
points are tracked, and a plane is fitted to their displacements around each.
"""

import matplotlib.pyplot as plt
import numpy as np

import fingerflow
from fingerflow import plot
from fingerflow.synthetic import Press, write_recording

press = Press(n_frames=72, frame_shape=(192, 480), rise_time=0.2, finger=(2.9, 2.4), semi_axes=(2.1, 1.7), force=1.5)
write_recording("press", press, progress=False)
result = fingerflow.process("press/scene.toml", outputs=["divergence", "divergence_std"])

# %%
# The map in the last frame, and how far the camera's noise alone lets each number be trusted.

_, axes = plt.subplots(figsize=(4.5, 3.4), layout="constrained")
plot.field_map(result, "divergence", frame=71, axes=axes)

deviation = 1e3 * result.divergence_std[-1]
print(f"one standard deviation: {float(deviation.median()):.1f} µm/mm (median of the points)")

# %%
# Numbers that are not known are NaN, never zero: a point outside the contact has no divergence.

known = np.isfinite(result.divergence[-1])
print(f"{int(known.sum())} of {known.size} points have a divergence in the last frame")
assert 0 < known.sum() < known.size
