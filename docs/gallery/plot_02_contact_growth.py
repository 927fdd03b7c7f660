"""
How fast does the contact grow?
===============================

The contact of an elastic finger grows with a power of the normal force. Areas of each frame stand beside the forces of
the same moment, so one line fits the power.
"""

import matplotlib.pyplot as plt
import numpy as np

import fingerflow
from fingerflow.synthetic import Press, write_recording

press = Press(n_frames=72, frame_shape=(192, 480), rise_time=0.2, finger=(2.9, 2.4), semi_axes=(2.1, 1.7), force=1.5)
write_recording("press", press, progress=False)
result = fingerflow.process("press/scene.toml", outputs=["gross_contact_area", "normal_force"])

# %%
# Areas under 3 mm² hold few ridges and are left out.

force, area = result.normal_force.values, result.gross_contact_area.values
large = (area > 3) & (np.gradient(force) > 0)
power, constant = np.polyfit(np.log(force[large]), np.log(area[large]), 1)
print(f"area = {np.exp(constant):.2f} mm² (F / N)^{power:.3f}; this finger was given a power of 0.5")
assert abs(power - 0.5) < 0.05

_, axes = plt.subplots(figsize=(4.5, 3.2), layout="constrained")
axes.plot(force[large], area[large], ".", label="measured")
axes.plot(force[large], np.exp(constant) * force[large] ** power, label=f"power {power:.2f}")
axes.set(xlabel="normal force (N)", ylabel="apparent contact area (mm²)")
axes.legend()
