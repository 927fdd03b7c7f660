"""
What does a bad recording look like, and what is said of it?
============================================================

The same small press is spoilt in seven ways that happen in labs. Below each picture stands the first warning of its
result, as `process`, the report and the page show it. What to do against each is on the page "When something looks
wrong".
"""

import json
import textwrap
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np

import fingerflow
from fingerflow.errors import FingerflowError
from fingerflow.synthetic import Press, write_recording

press = Press(n_frames=24, frame_rate=24.0, frame_shape=(192, 480), finger=(2.9, 2.4), semi_axes=(2.1, 1.7), force=1.5)
write_recording("press", press, progress=False)
scene = Path("press/scene.toml")
scene.write_text(scene.read_text("utf-8").replace("points = 700 ", "points = 120 "), "utf-8")
frames, empty = np.load("press/frames.npy"), np.load("press/empty.npy")
HALF = frames.shape[2] // 2  # the topography view lies left, the contact view right

# %%
# Each fault is a function of frames and of the picture of the empty glass.


def as_pixels(values: np.ndarray) -> np.ndarray:
    """Return grey values as a camera stores them: whole numbers from 0 to 255."""
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def hair(picture: np.ndarray) -> np.ndarray:
    """Draw a hair from edge to edge of the contact view."""
    return cv2.polylines(picture.copy(), [np.array([(HALF + 20, 0), (HALF + 60, 90), (HALF + 40, 191)])], False, 20, 3)


def blurred(picture: np.ndarray) -> np.ndarray:
    """Return a picture out of focus."""
    return cv2.GaussianBlur(picture, (0, 0), 5)


flicker = np.where(np.arange(len(frames)) % 2, 0.7, 1.0)[:, None, None]
dark = frames.copy()
dark[17] = 0
stuck = frames.copy()
stuck[10:18] = stuck[10]
spoilt = {
    "out of focus": (np.stack([blurred(frame) for frame in frames]), empty),
    "lamp flickers": (as_pixels(frames * flicker), empty),
    "overexposed": (as_pixels(2.4 * frames.astype(float)), as_pixels(2.4 * empty.astype(float))),
    "hair on the glass": (np.stack([hair(frame) for frame in frames]), empty),
    "finger on the empty glass": (frames, frames[-4:]),
    "a frame without light": (dark, empty),
    "frames stored twice": (stuck, empty),
}

# %%
# Every one is processed with the settings of the sound recording.


def first_words(trial: tuple[np.ndarray, np.ndarray]) -> str:
    """Process a spoilt press, and return its first warning, or the error that ends it."""
    np.save("press/frames.npy", trial[0])
    np.save("press/empty.npy", trial[1])
    try:
        result = fingerflow.process("press/scene.toml", outputs=["median_divergence", "gross_contact_area"])
    except FingerflowError as error:
        message = str(error)
    else:
        message = next(iter(json.loads(result.attrs["warnings"])), "nothing")
    return message.replace(f"{Path.cwd()}/", "").replace("press/", "")


messages = {name: first_words(trial) for name, trial in spoilt.items()}
_, panels = plt.subplots(2, 4, figsize=(12, 5.4), layout="constrained")
for panel, (name, message) in zip(panels.flat, messages.items(), strict=False):
    panel.imshow(spoilt[name][0][17 if "without" in name else -1], cmap="gray", vmin=0, vmax=255)
    panel.set_title(name, fontsize=11)
    panel.set_xlabel("\n".join(textwrap.wrap(message, 44)[:13]), fontsize=8, loc="left")
    panel.set(xticks=[], yticks=[])
panels[-1, -1].axis("off")
for name, message in messages.items():
    print(f"{name}: {message}\n")
assert "nothing" not in messages.values()
