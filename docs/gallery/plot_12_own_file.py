"""
From a lab's own files to numbers and a figure
==============================================

All that `fingerflow` needs of a lab is a recording, a picture of the empty glass, the scale and, if there are any,
forces. Download this page as a notebook, leave out the block that writes stand-ins, name your
files in the next, and go through it from top to bottom.
"""

import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tifffile

import fingerflow
from fingerflow import plot
from fingerflow.schema.scene_template import scene_text
from fingerflow.schema.views import View
from fingerflow.synthetic import Press, write_recording

# %%
# **Stand-ins for your files**: a TIFF stack, another of the empty glass, and a table of forces. Leave this block out.

press = Press(n_frames=48, frame_rate=48.0, frame_shape=(192, 480), finger=(2.9, 2.4), semi_axes=(2.1, 1.7), force=1.5)
write_recording("raw", press, progress=False)
tifffile.imwrite("press.tif", np.load("raw/frames.npy"))
tifffile.imwrite("empty.tif", np.load("raw/empty.npy"))
Path("raw/forces.csv").rename("forces.csv")

# %%
# **Your files, and what they do not state.** Rows and columns say where each view lies in the frame, half-open; give
# `contact` alone for a camera with one view. The calibration is `file = "calibration.toml"` after
# `fingerflow calibrate --ring ring.tif --target target.tif --background empty.tif`, or numbers, as here.

files = {"frames": "press.tif", "background": "empty.tif", "forces": "forces.csv"}
views = {"topography": View((0, 192), (0, 240)), "contact": View((0, 192), (240, 480))}
rows = [[float(number) for number in row] for row in press.topography_to_contact]
calibration = f"mm_per_px = {press.mm_per_px}\ntopography_to_contact = {rows}"

# %%
# **What does the recording hold?** Look before you process: number, size and type of the frames, and two of them.

recording = fingerflow.open_recording(files["frames"])
print(f"{len(recording)} frames of {recording.frame_shape} px, {recording.dtype}, rate {recording.frame_rate} Hz")
_, panels = plt.subplots(1, 2, figsize=(9, 2.4), layout="constrained")
for panel, number in zip(panels, (0, len(recording) - 1), strict=True):
    panel.imshow(recording[[number]].read()[0], cmap="gray")
    panel.set_title(f"frame {number}")
    panel.axis("off")

# %%
# **The scene file** holds every setting with its meaning; read it once. The TIFF states no frame rate, so it is given.

text = scene_text(**files, **views, frame_rate=48.0, trigger_frame=press.frames_before_trigger, calibration=calibration)
Path("scene.toml").write_text(text, encoding="utf-8")

# %%
# **Process**, and read the warnings first: each names the frames, the value and a remedy.

result = fingerflow.process("scene.toml", to="result.h5")
for warning in json.loads(result.attrs["warnings"]):
    print("-", warning)

# %%
# **Look at the contact**: the outline must follow what you see.

scene, last = fingerflow.load_scene("scene.toml"), result.sizes["frame"] - 1
_, (left, middle, right) = plt.subplots(1, 3, figsize=(12, 3.4), layout="constrained")
plot.picture(result, scene, last, left, view="contact")
plot.contact_area(result, middle)
plot.field_map(result, "divergence", last, right)

# %%
# **Take the numbers**, each with its deviation. `fingerflow export-table result.h5 table.csv` writes them for other
# programs, `fingerflow report scene.toml` a page to keep.

area, deviation = (float(result[name][last]) for name in ("gross_contact_area", "gross_contact_area_std"))
print(f"gross contact area {area:.2f} ± {deviation:.2f} mm²")
assert abs(area / press.truth.gross_contact_area_mm2(last) - 1) < 0.05
