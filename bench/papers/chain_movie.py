"""Movie M3 of Willemet et al. 2021: deformation of a simulated fingertip at low and at high friction."""

from collections.abc import Iterator

import numpy as np
from matplotlib.collections import LineCollection
from numpy.typing import NDArray

from bench.papers.chain import HIGH, SimulatedPresses
from bench.papers.drawn import new_frame, picture_of
from fingerflow.plot.axes_style import INK, RED

_WIDE_MM = 9.0  # mm, shown half width of the finger
_LARGEST_MM = 1e-3  # mm, least limit of the colour scale


def movie_pictures(presses: SimulatedPresses, step: int) -> Iterator[NDArray[np.uint8]]:
    """Yield one RGB image (H, W, 3) at each `step`-th time of simulated presses: deformed skin and contact loads."""
    figure = new_frame("constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey="row", height_ratios=(1.4, 1))
    # At 0.2 nearly all skin sticks already, and the movie would look like that of friction 1.
    pair = min(presses.friction), HIGH
    chosen = [presses.friction.index(friction) for friction in pair]
    chain = presses.chain
    moved = 1e3 * chain.displacement[:, chosen, :, 0].numpy()
    on_plate = chain.normal_force[:, chosen].numpy() > 0
    largest = float(np.abs(moved[on_plate]).max(initial=_LARGEST_MM))
    highest = 1.1e-3 * float(chain.pressure[:, chosen].max())
    skins, loads = [], []
    for column, friction in enumerate(pair):
        top, bottom = axes[:, column]
        skin = LineCollection([], cmap="coolwarm", linewidths=3)
        skin.set_clim(-largest, largest)
        top.add_collection(skin)
        top.axhline(0, color=INK, linewidth=1)
        top.set(xlim=(-_WIDE_MM, _WIDE_MM), ylim=(-0.6, 8.5), aspect="equal", title=f"friction {friction:g}")
        pressure = bottom.plot([], [], color=INK, label="pressure")
        traction = bottom.plot([], [], color=RED, linestyle="--", label="traction")
        bottom.set(ylim=(-0.4 * highest, highest), xlabel="along the plate (mm)")
        bottom.grid(alpha=0.25)
        skins.append(skin)
        loads.append(pressure + traction)
    axes[0, 0].set_ylabel("above the plate (mm)")
    axes[1, 0].set_ylabel("on the skin (kPa)")
    axes[1, 1].legend(frameon=False, loc="upper right")
    figure.colorbar(skins[0], ax=list(axes[0]), label="displacement along the plate (mm)")
    heading = figure.suptitle(" ")
    for frame in range(0, len(presses.time), step):
        for column, k in enumerate(chosen):
            place = 1e3 * chain.position[frame, k].numpy()
            skins[column].set_segments(list(np.stack((place[:-1], place[1:]), 1)))
            skins[column].set_array((moved[frame, column, 1:] + moved[frame, column, :-1]) / 2)
            for line, load in zip(loads[column], (chain.pressure, chain.traction), strict=True):
                line.set_data(place[:, 0], 1e-3 * load[frame, k].numpy())
        heading.set_text(f"{presses.time[frame]:.2f} s, {presses.force[frame]:.2f} N")
        yield picture_of(figure)
        figure.set_layout_engine("none")  # the layout is computed only once, as it takes ten times as long as drawing
