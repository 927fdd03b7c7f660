"""
Which part of the contact still sticks?
=======================================

A finger is pulled sideways under a constant normal force. Skin slips from the rim of the contact inwards; d² is the
share of the contact that still sticks. Does it fade to nothing, or vanish at once from a critical size?
"""

import matplotlib.pyplot as plt
import numpy as np

import fingerflow
from fingerflow.models.partial_slip import critical_stuck_area, judge_trial
from fingerflow.synthetic import PartialSlip, write_recording

trial = PartialSlip(
    n_frames=120, frame_shape=(256, 640), finger=(4.0, 3.4), semi_axes=(3.0, 2.5), creep=0.6, travel=0.8
)
write_recording("slip", trial, progress=False)

result = fingerflow.process("slip/scene.toml", outputs=["stuck_ratio", "stuck_ratio_std", "load_ratio"])

# %%
# d² in each frame beside its truth, against the load T/N.

true = np.array([trial.stuck_share(frame) for frame in range(trial.n_frames)])
error = result.stuck_ratio.values - true
print(f"d²: RMS error {np.sqrt(np.nanmean(error**2)):.3f}, stated {float(result.stuck_ratio_std.median()):.3f}")
assert np.sqrt(np.nanmean(error**2)) < 0.06

_, axes = plt.subplots(figsize=(5, 3.2), layout="constrained")
axes.plot(result.load_ratio, result.stuck_ratio, ".", label="measured")
axes.plot(result.load_ratio, true, label="truth")
axes.set(xlabel="T/N", ylabel="stuck share of the contact, d²")
axes.legend()

# %%
# The verdict assumes no law of friction: does the area still follow the load when it begins to vanish?

verdict = judge_trial(result.stuck_ratio, result.load_ratio, result.time, result.stuck_ratio_std)
area, deviation = verdict.critical_area, verdict.critical_area_std
print(f"{verdict.outcome} from d² = {area:.2f} ± {deviation:.2f}, in {verdict.collapse_ms:.0f} ms")
print(f"truth: from {float(critical_stuck_area(0.8, 0.4)):.2f} in 200 ms")
assert verdict.outcome == "vanishes abruptly"
