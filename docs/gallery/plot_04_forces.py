"""
Are frames and forces on one clock?
===================================

A force sensor samples at 10 kHz, a camera at 300 Hz, and a trigger starts both. Forces are shifted so that the trigger
is at time 0, low-passed to half the frame rate, and evaluated at the moments of the frames.
"""

import matplotlib.pyplot as plt
import numpy as np

from fingerflow import open_forces

rate, frame_rate = 10_000, 300
time = np.arange(0, 1, 1 / rate)
force = 2 * np.clip(time - 0.2, 0, None)
vibration = 0.1 * np.sin(2 * np.pi * 400 * time)
trigger = np.where(time > 0.1, 5.0, 0.0)
np.savetxt(
    "forces.csv",
    np.column_stack((time, force + vibration, trigger)),
    delimiter=",",
    header="time (s),normal (N),camera (V)",
    comments="",
)

# %%
# Picking every 33rd sample would fold the vibration at 400 Hz into the frames; the low-pass filter has no phase.

forces = open_forces("forces.csv", channels={"normal_force": "normal"}, time="time", trigger="camera").align(2.5)
frames = np.arange(0.0, 0.85, 1 / frame_rate)
filtered = forces.resample(frames)["normal_force"]
picked = np.interp(frames + 0.1, time, force + vibration)
true = np.interp(frames + 0.1, time, force)
inner = (frames > 0.05) & (frames < 0.8)
print(
    f"largest error: picked {abs(picked - true)[inner].max():.3f} N, filtered {abs(filtered - true)[inner].max():.3f} N"
)
assert abs(filtered - true)[inner].max() < 0.01

_, axes = plt.subplots(figsize=(5, 3), layout="constrained")
axes.plot(frames, picked, ".", label="nearest sample")
axes.plot(frames, filtered, label="low-pass filtered")
axes.set(xlabel="time since the trigger (s)", ylabel="normal force (N)", xlim=(0.2, 0.4), ylim=(0.1, 0.7))
axes.legend()
