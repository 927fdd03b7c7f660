"""One HTML page with everything in it."""

import base64
import io
import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import xarray as xr
from jinja2 import Environment

from fingerflow.atomic_write import MARK, is_marked, keep_others, spare, write_atomically
from fingerflow.recordings import open_recording
from fingerflow.report import figures
from fingerflow.report.beside_chain import BesideChain, draw
from fingerflow.report.overlay import write_overlay
from fingerflow.report.slip_trials import SlipTrial, trial_figure, verdict_line
from fingerflow.report.views import ViewPainter
from fingerflow.scene import Scene

_DEFORMATION = "Deformation, medians over the gross contact"


def write_report(
    result: xr.Dataset,
    scene: Scene | None,
    folder: Path,
    comparison: Sequence[Any] = (),
    chain: BesideChain | None = None,
    video: bool = True,
    overwrite: bool = False,
) -> Path:
    """Writes report.html and overlay.mp4 into a folder; sections whose variables were not asked for are left out.

    Without a scene, as of a stream, whose frames are gone, there is neither picture nor video.

    ``comparison``: rows with quantity, unit, measured, truth and error, of a synthetic recording.
    ``video``: write overlay.mp4 too, which takes longer than all the rest.
    ``chain``: predictions of the skin chain, drawn beside what was measured.

    Raises FingerflowError, before anything is computed, where a file of these names is an input, or without
    ``overwrite`` one that no report has written.
    """
    for output in ("report.html", "overlay.mp4") if scene is not None else ("report.html",):
        spare(folder / output, *(scene.files() if scene is not None else ()))
        keep_others(folder / output, is_marked, overwrite)
    frame = _most_contact(result)
    sections: list[tuple[str, bytes]] = []
    notes: dict[str, Sequence[str]] = {}
    if scene is not None:
        if video:
            write_overlay(result, scene, folder / "overlay.mp4")
        with open_recording(scene.recording.frames, frame_rate=scene.recording.frame_rate) as recording:
            picture = ViewPainter(result, scene, recording).paint(frame)
        encoded = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))[1].tobytes()
        shown = "contact, points and the stuck part" if "stuck_region" in result else "contact and points"
        sections.append((f"Frame {frame}: {shown}", encoded))
    if "ellipse_semi_axes" in result:
        sections.append(("Contact", figures.areas(result)))
    if "gross_slip" in result:
        sections.append(("Slip of what touches the gel", figures.sensor_slip(result)))
    if "median_divergence" in result:
        sections.append((_DEFORMATION, figures.medians(result)))
        if since := result["median_divergence"].attrs.get("reference"):
            notes[_DEFORMATION] = [f"Displacement counts from {since}."]
    if "strain" in result and "divergence" in result and result.sizes["triangle"]:
        sections.append((f"Maps on the skin, frame {frame}", figures.maps(result, frame)))
    if "stuck_ratio" in result and "verdict" in result["stuck_ratio"].attrs:
        trial = SlipTrial.of(result, "Partial slip")
        drawn = io.BytesIO()
        trial_figure(trial).savefig(drawn, format="png", dpi=80)
        sections.append((verdict_line(trial), drawn.getvalue()))
    if "tracked_share" in result and "position_std_px" in result:
        sections.append(("Quality", figures.quality(result)))
    if chain is not None:
        sections.append(("Beside the skin chain", draw(chain)))
        notes["Beside the skin chain"] = chain.notes()
    seconds = json.loads(result.attrs["stage_seconds"])
    count = result.sizes["frame"]
    template = Environment(autoescape=True).from_string(files(__package__).joinpath("page.html").read_text("utf-8"))
    html = template.render(
        mark=MARK,
        attrs=result.attrs,
        settings={
            name: value for name, value in json.loads(result.attrs["settings"]).items() if isinstance(value, dict)
        },
        warnings=json.loads(result.attrs["warnings"]),
        comparison=comparison,
        sections=[(title, base64.b64encode(data).decode("ascii"), notes.get(title, ())) for title, data in sections],
        stages=[(name, value, 1000 * value / count) for name, value in seconds.items()],
        sizes=dict(result.sizes),
    )
    path = folder / "report.html"
    write_atomically(path, lambda part: part.write_text(html, encoding="utf-8"))
    return path


def _most_contact(result: xr.Dataset) -> int:
    if "gross_contact_area" not in result:
        return result.sizes["frame"] - 1
    return int(np.argmax(result["gross_contact_area"].fillna(0).values))
