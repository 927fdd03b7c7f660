"""
A press, from raw frames to a figure
====================================

How do contact area and divergence of the skin grow as a finger presses glass? A small synthetic press, whose motion
and contact are known exactly, is written as a lab's recording would be, processed, and compared with its truth.
"""

import matplotlib.pyplot as plt

import fingerflow
from fingerflow import plot
from fingerflow.synthetic import Press, rebuild_scene, write_recording

press = Press(n_frames=72, frame_shape=(192, 480), rise_time=0.2, finger=(2.9, 2.4), semi_axes=(2.1, 1.7), force=1.5)
write_recording("press", press, progress=False)

# %%
# Only what is asked for is computed; leave `outputs` out for all variables.

wanted = ["gross_contact_area", "real_contact_area", "divergence", "median_divergence", "median_divergence_std"]
result = fingerflow.process("press/scene.toml", outputs=wanted)
print(result.attrs["warnings"])
print(result.median_divergence.attrs["long_name"])

# %%
# Functions of `fingerflow.plot` draw into axes of your own and return them.

_, (left, right) = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
plot.contact_area(result, left)
plot.median_divergence(result, right)

# %%
# Against the truth. The area of a contact of 11 mm² with a handful of ridges is good to some per cent: where the border
# runs along a ridge, no picture tells where in it the contact ends.

truth = rebuild_scene("press").truth
measured, true = float(result.gross_contact_area[-1]), truth.gross_contact_area_mm2(71)
print(f"gross area {measured:.2f} mm², truth {true:.2f} mm²")
assert abs(measured / true - 1) < 0.05

divergence, deviation = (1e3 * float(result[name][-1]) for name in ("median_divergence", "median_divergence_std"))
print(f"median divergence {divergence:.1f} ± {deviation:.1f} µm/mm")
