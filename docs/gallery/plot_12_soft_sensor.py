"""
When does an object slip from a soft sensor?
============================================

Printed markers move with the surface of a gel. Here an object presses, drags the gel, and slips as a whole at a known
moment.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import fingerflow
from fingerflow import plot
from fingerflow.synthetic.marker_gel import MarkerGel, write_gel_recording

gel = MarkerGel(n_frames=40)
scene = write_gel_recording(Path("gel"), gel, mm_per_px=0.06)
result = fingerflow.process(scene, outputs=["gross_slip", "displacement"])

# %%
# `gross_slip` is 1 in the frame in which the gel springs back.

slips = np.flatnonzero(result.gross_slip)
print(f"gross slip in frame {slips.tolist()}")
true = round(0.7 * (gel.n_frames - 1))
assert any(abs(frame - true) <= 1 for frame in slips)

_, axes = plt.subplots(figsize=(5, 3), layout="constrained")
plot.displacement(result, axes, against="time")
axes.axvline(float(result.time[slips[-1]]), color="tab:red", linestyle=":")
