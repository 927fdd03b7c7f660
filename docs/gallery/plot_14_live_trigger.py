"""
Can a contact area switch on a stimulus?
========================================

The live player gives the numbers of each frame to a function of yours, and sends a trigger to another program where a
condition becomes true. Here a synthetic camera shows a finger that presses again and again, and a socket of this
script stands for the stimulator.
"""

import json
import socket
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from fingerflow.export import export_bundle
from fingerflow.player import FrameStamp, play

# %%
# A bundle is exported once. The compiled library, which plays it here, needs no graphs; for ONNX Runtime leave out
# `graphs`, and the export takes a minute.

Path("small.toml").write_text("""
[views]
height = 192
width = 240
[tracking]
points = 100
window_px = 15
[export]
graphs = ["noise"]
""")
export_bundle(Path("small.toml"), Path("bundle"))

# %%
# The function is called with the stamp and the values of each frame. The trigger leaves as a datagram; a serial line is
# `serial:/dev/ttyUSB0:1`. Noise about a limit would trigger several times: with `margin 1` the next trigger follows
# only after the area has fallen to 4 mm².

LIMIT = 5.0  # mm²
frames: list[tuple[float, float, float]] = []  # camera time, area, latency


def take(stamp: FrameStamp, values: dict[str, float]) -> None:
    """Keep the camera's time, the area and the latency of a frame."""
    frames.append((stamp.camera_time, values["gross_contact_area"], stamp.written - stamp.camera_time))


with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stimulator:
    stimulator.bind(("127.0.0.1", 0))
    stimulator.settimeout(1)
    summary = play(
        "bundle",
        "synthetic",
        take,
        rate=60,
        frames=300,
        policy="every",
        page="off",
        when=f"gross_contact_area > {LIMIT} mm2, margin 1",
        then=f"udp:127.0.0.1:{stimulator.getsockname()[1]}",
        values="gross_contact_area",
    )
    sent = next(one["sent"] for one in summary["outputs"] if one["output"].startswith("udp"))
    triggers = [json.loads(stimulator.recv(4096)) for _ in range(sent)]

# %%
# A press takes 118 frames, and so does the way from one trigger to the next. Latency runs from the camera's frame to
# the call of the function, and to the sending of the trigger; on a busy computer it is longer, and no frame is lost.

print(summary["latency_ms"])
print([(one["frame"], round(one["gross_contact_area"], 2)) for one in triggers])
assert len(triggers) == 3
assert all(abs(step - 118) <= 2 for step in np.diff([one["frame"] for one in triggers]))

time, area, latency = np.array(frames).T
start = time[0]
_, (left, right) = plt.subplots(1, 2, figsize=(8.5, 3), width_ratios=(1.5, 1), layout="constrained")
left.plot(time - start, area)
left.axhline(LIMIT, color="0.6", linewidth=0.8)
at = [one["camera_time"] - start for one in triggers]
left.plot(at, [one["gross_contact_area"] for one in triggers], "v", color="tab:red", label="trigger")
left.set(xlabel="time (s)", ylabel="apparent contact area (mm²)")
left.legend()
right.hist(1e3 * latency, bins=30, label="frames to the function")
right.plot(
    [1e3 * (one["written"] - one["camera_time"]) for one in triggers],
    np.zeros(len(triggers)),
    "v",
    color="tab:red",
    clip_on=False,
    label="triggers",
)
right.set(xlabel="latency since the camera's frame (ms)", ylabel="frames")
right.legend()
