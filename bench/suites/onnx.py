"""Time and error of exported graphs in ONNX Runtime on the CPU, for each setting of a recipe.

One 512 x 640 view of a simulated press, 8 bit, noise of 2 grey levels, hot and dead pixels; ONNX Runtime with as many
threads as torch. `contact` goes from frame to areas, ellipse and threshold; its peer is OpenCV's way from the frame to
the pixels in real contact with the same median (illumination quotient, medianBlur, Otsu, count: `image_ops`), without
gross area and ellipse. `error` is that of the real contact area against the truth, in per cent. `track` follows corners
over three frames, there and back; its peer is calcOpticalFlowPyrLK on one level with the same window; `error` is the
RMS of the accepted points, in px. `frame` does everything for one step of a stream; its `error` is that of `track`.
`time_to_peer` is taken in turns. `nodes` are those that the exported file holds, constants left out.

What limits `contact` with a median of 9 px. With a stride, medians are formed where they are counted, of 1172 minima
and maxima each; for the other pixels it is enough whether most of their window lies above the threshold. Without, every
median is needed: 218 minima and maxima a pixel, 71 MB of planes of bytes. ONNX Runtime writes 18 bytes a ns in the
second cache and 8 in the third, and a node costs 1.2 us whatever it holds: 985 nodes on planes of 82 kB take 5 ms at
best. Run depth first from the outputs they keep 146 planes alive, 12 MB, and take 8, with two threads too. Bands of
rows that fit the cache cost more nodes than they save: 7.8, 7.7, 9.2 and 12.4 ms for 1, 2, 4 and 8 bands of tiles of
2 x 1 px, 7.2, 9.0, 11.4 and 17.2 of 2 x 2. OpenCV's medianBlur took 13.3 ms in the same minutes. Each of the two
histograms of all pixels scatters 7 ns a pixel, 2.3 ms; as a product of digits, of bytes or of floats, 4.5 or 7.7.
"""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from torch import Tensor

from bench.opencv_contact import opencv_contact
from bench.rows import Row
from bench.timing import time_in_turns
from bench.trackers import track_opencv
from fingerflow.export.build import build_graphs
from fingerflow.export.portable import PortableSession
from fingerflow.export.write_bundle import write_graph
from fingerflow.ops.filters.illumination import glass_light
from fingerflow.ops.tracking.corners import detect_corners
from fingerflow.schema.recipe import GRAPHS, GraphName, Recipe, parse_recipe
from fingerflow.synthetic import Press

_FROM, _TO, _AREA = 296, 299, 299  # frames of the press
Run = Callable[[], dict[str, np.ndarray]]

CONTACT: list[dict[str, Any]] = [
    {},
    {"median_px": 9},
    {"median_px": 9, "stride_px": 8},
    {"median_px": 5, "stride_px": 8},
    {"stride_px": 8},
    {"median_px": 1, "stride_px": 8},
]
TRACKING: list[dict[str, Any]] = [
    {"points": 700, "window_px": 25},
    {"points": 700, "window_px": 21},
    {"points": 300, "window_px": 15},
    {"points": 300, "window_px": 11},
]


def run(quick: bool) -> list[Row]:
    """Return a row per setting of a graph."""
    rounds = 3 if quick else 15
    scene = Press()
    known = _inputs(scene)
    area = scene.truth.real_contact_area_mm2(_AREA)
    rows: list[Row] = []
    for settings in CONTACT[4:5] if quick else CONTACT:
        recipe = _recipe(contact=settings)
        nodes, ours = _session(recipe, "contact", known)
        contact = opencv_contact(known["contact_view"], known["empty"], recipe.contact.median_px)
        times = time_in_turns({"opencv": contact, "onnx": ours}, "opencv", rounds)["onnx"]
        found = float(ours()["real_area_px"][0]) * scene.mm_per_px**2
        rows.append(_row("contact", settings, nodes, times.cells(), 100 * (found / area - 1)))
    for settings in TRACKING[-1:] if quick else TRACKING:
        recipe = _recipe(tracking=settings)
        points = _corners(known["topography_before"], recipe)
        nodes, ours = _session(recipe, "track", {**known, "points": points})
        peer = partial(
            track_opencv, known["topography_before"], known["topography_view"], points, recipe.tracking.window_px
        )
        cells = time_in_turns({"opencv": peer, "onnx": ours}, "opencv", rounds)["onnx"].cells()
        true = scene.truth.follow(points[0].double().numpy(), _FROM, _TO)
        error = float(np.sqrt(np.nanmean(np.sum((ours()["points"][0] - true) ** 2, axis=-1))))
        rows.append(_row("track", settings, nodes, cells, error))
    return rows


def _row(graph: str, settings: dict[str, Any], nodes: int, cells: dict[str, float], error: float) -> Row:
    text = ", ".join(f"{name} {value}" for name, value in settings.items()) or "as recipes are by default"
    return {"graph": graph, "settings": text, "nodes": nodes, **cells, "error": error}


def _recipe(**tables: dict[str, Any]) -> Recipe:
    return parse_recipe({"views": {"height": 512, "width": 640}, "export": {"graphs": GRAPHS}, **tables})


def _inputs(scene: Press) -> dict[str, Tensor]:
    def view(name: str, picture: np.ndarray) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(scene.views[name].crop(picture)))[None, None]

    empty = view("contact", scene.empty())
    last = scene.render(_TO)
    return {
        "contact_view": view("contact", last),
        "topography_view": view("topography", last),
        "topography_before": view("topography", scene.render(_FROM)),
        "empty": empty.float(),
        "dark": torch.zeros(empty.shape),
        "threshold": torch.tensor([0.267]),
    }


def _corners(view: Tensor, recipe: Recipe) -> Tensor:
    return detect_corners(view, recipe.tracking.points, 6.0, window=5, border=recipe.tracking.window_px // 2 + 4).points


def _session(recipe: Recipe, name: GraphName, known: dict[str, Tensor]) -> tuple[int, Run]:
    """Return the number of nodes of the exported graph, and a call that runs it."""
    graphs = build_graphs(recipe)
    light, black = glass_light(known["empty"], known["dark"])
    tensors = known | {"light": light, "black": black}
    if "points" in tensors:
        tensors |= {"prediction": tensors["points"]}
        for graph in ("noise", "prepare"):
            tensors |= PortableSession(graphs[graph])({**tensors, "topography_view": tensors["topography_before"]})
    with tempfile.TemporaryDirectory() as folder:
        inputs = [torch.as_tensor(tensors[one]) for one in graphs[name].inputs]
        write_graph(recipe, name, graphs[name], tuple(inputs), Path(folder))
        file = Path(folder) / f"{name}.onnx"
        nodes = sum(node.op_type != "Constant" for node in onnx.load(file).graph.node)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = torch.get_num_threads()
        session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    # In one piece, as the graphs give them: a transposed view would be copied in every run.
    feed = {one.name: np.ascontiguousarray(tensors[one.name]) for one in session.get_inputs()}
    outputs = [one.name for one in session.get_outputs()]
    return nodes, lambda: dict(zip(outputs, session.run(outputs, feed), strict=True))
