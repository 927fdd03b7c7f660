"""A bundle of graphs small enough to know by heart, with the inputs and outputs that the export writes.

Pixel (0, 0) of the topography view says how many of the points are found: what is lost is told by the test; pixel
(0, 1) says how far they have moved since the key frame, pixel (0, 2) how many templates are stale, each of which moves
its point by a pixel in x when it is renewed. The other outputs are simple: `error` is the number that pixel
(0, 0) had in the key frame, `expected` is x or y of the prediction, `divergence` counts frames since the restart (a
state), `curl` is x or y of where points were chosen, areas are the pixels that lose more than the threshold of light.
Where the scene gives none it is half of what the darkest pixel loses, and unknown while that is less than 0.2.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

HEIGHT, WIDTH, POINTS, RENEWED = 24, 32, 10, 4
_OF_TYPE = {
    "float": TensorProto.FLOAT,
    "bool": TensorProto.BOOL,
    "uint8": TensorProto.UINT8,
    "uint16": TensorProto.UINT16,
}


def write_bundle(folder: Path, bit_depth: int = 8, without: str = "", **changes: Any) -> Path:
    """Writes the bundle, all graphs but one; ``changes`` replace entries of bundle.json."""
    folder.mkdir(parents=True)
    pixel = "uint8" if bit_depth == 8 else "uint16"
    graphs = {}
    for name, model in _models(pixel).items():
        if name == without:
            continue
        model.metadata_props.add(key="fingerflow.graph", value=name)
        model.metadata_props.add(key="fingerflow.units", value=json.dumps({"error": "px", "expected": "px"}))
        onnx.checker.check_model(model)
        data = model.SerializeToString()
        (folder / f"{name}.onnx").write_bytes(data)
        graphs[name] = {"file": f"{name}.onnx", "sha256": hashlib.sha256(data).hexdigest()}
    recipe = {"views": {"height": HEIGHT, "width": WIDTH, "bit_depth": bit_depth}, "tracking": {"window_px": 15}}
    facts = {"format": 4, "fingerflow": "0.1.0", "recipe": recipe, "graphs": graphs}
    (folder / "bundle.json").write_text(json.dumps(facts | changes))
    return folder


def write_scene(path: Path, extra: str = "", background: str = "empty.npy") -> Path:
    """A scene whose frames hold the topography view on the left and the contact view on the right."""
    np.save(path.parent / "empty.npy", np.full((HEIGHT, 2 * WIDTH), 200, np.uint8))
    path.write_text(
        f"""[views.contact]
rows = [0, {HEIGHT}]
columns = [{WIDTH}, {2 * WIDTH}]
[views.topography]
rows = [0, {HEIGHT}]
columns = [0, {WIDTH}]
[background]
frames = "{background}"
[calibration]
mm_per_px = 0.5
topography_to_contact = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
[contact]
threshold = 0.5
{extra}
"""
    )
    return path


def frame(found: int = POINTS, contact_px: int = 0, moved: int = 0, stale: int = 0) -> np.ndarray[Any, Any]:
    """A frame in which so many points are found, moved by quarters of a pixel, and so many pixels touch."""
    picture = np.full((HEIGHT, 2 * WIDTH), 200, np.uint8)
    picture[:, :WIDTH] = 90
    picture[0, 0], picture[0, 1], picture[0, 2] = found, 90 + moved, stale
    picture[:, WIDTH:].reshape(-1)[:0] = 0
    contact = np.full(HEIGHT * WIDTH, 200, np.uint8)
    contact[:contact_px] = 20
    picture[:, WIDTH:] = contact.reshape(HEIGHT, WIDTH)
    return picture


def _models(pixel: str) -> dict[str, onnx.ModelProto]:
    view = (1, 1, HEIGHT, WIDTH)
    names = np.arange(POINTS, dtype=np.float32)[None]
    places = np.stack([3 + 2 * names[0], 5 + names[0]], -1)[None].astype(np.float32)
    corner = [
        helper.make_node("Cast", ["topography_view"], ["topography"], to=TensorProto.FLOAT),
        helper.make_node("Slice", ["topography", "zero4", "one4", "axes"], ["pixel4"]),
        helper.make_node("Reshape", ["pixel4", "flat"], ["pixel"]),
    ]
    corner_constants = {
        "zero4": np.zeros(2, np.int64),
        "one4": np.ones(2, np.int64),
        "axes": np.array([2, 3]),
        "flat": np.array([1, 1]),
    }
    return {
        "background": _model(
            [
                helper.make_node("Sub", ["background", "dark"], ["difference"]),
                helper.make_node("Reciprocal", ["difference"], ["gain"]),
                helper.make_node("Identity", ["threshold"], ["limit"]),
            ],
            {"background": ("float", view), "dark": ("float", view), "threshold": ("float", (1,))},
            {"gain": ("float", view), "limit": ("float", (1,))},
            {},
        ),
        "contact": _model(
            [
                helper.make_node("Cast", ["contact_view"], ["counts"], to=TensorProto.FLOAT),
                helper.make_node("Mul", ["counts", "gain"], ["left"]),
                helper.make_node("Sub", ["one", "left"], ["gone"]),
                helper.make_node("ReduceMax", ["gone", "image"], ["most"], keepdims=0),
                helper.make_node("Mul", ["most", "half"], ["middle"]),
                helper.make_node("Greater", ["middle", "least"], ["contact"]),
                helper.make_node("Where", ["contact", "middle", "nan"], ["threshold"]),
            ],
            {"contact_view": (pixel, view), "gain": ("float", view)},
            {"threshold": ("float", (1,))},
            {
                "one": np.ones(1, np.float32),
                "image": np.array([1, 2, 3]),
                "half": np.full(1, 0.5, np.float32),
                "least": np.full(1, 0.1, np.float32),
                "nan": np.full(1, np.nan, np.float32),
            },
        ),
        "detect": _model(
            [
                helper.make_node("Cast", ["topography_view"], ["seen"], to=TensorProto.FLOAT),
                helper.make_node("Cast", ["mask"], ["inside"], to=TensorProto.FLOAT),
                helper.make_node("Mul", ["seen", "inside"], ["masked"]),
                helper.make_node("ReduceMax", ["masked", "image"], ["brightest"], keepdims=0),
                helper.make_node("Greater", ["brightest", "zero"], ["any"]),
                helper.make_node("Where", ["any", "places", "nan"], ["points"]),
                helper.make_node("Identity", ["names"], ["strength"]),
            ],
            {"topography_view": (pixel, view), "mask": ("bool", view)},
            {"points": ("float", (1, POINTS, 2)), "strength": ("float", (1, POINTS))},
            {
                "places": places,
                "names": names,
                "image": np.array([1, 2, 3]),
                "zero": np.zeros(1, np.float32),
                "nan": np.full((1, 1, 1), np.nan, np.float32),
            },
        ),
        "key": _model(
            [
                *corner,
                helper.make_node("Identity", ["pixel"], ["template_pixel"]),
                helper.make_node("Identity", ["points"], ["template_start"]),
            ],
            {"topography_view": (pixel, view), "points": ("float", (1, POINTS, 2))},
            {"template_pixel": ("float", (1, 1)), "template_start": ("float", (1, POINTS, 2))},
            corner_constants,
        ),
        "frame": _model(
            [
                *corner,
                helper.make_node("Less", ["names", "pixel"], ["seen"]),
                helper.make_node("Unsqueeze", ["seen", "last"], ["seen2"]),
                helper.make_node("Slice", ["topography", "second", "third", "axes"], ["motion4"]),
                helper.make_node("Reshape", ["motion4", "flat3"], ["motion"]),
                helper.make_node("Sub", ["motion", "rest"], ["quarters"]),
                helper.make_node("Mul", ["quarters", "quarter"], ["shift"]),
                helper.make_node("Mul", ["prediction", "nothing"], ["known_ones"]),
                helper.make_node("Add", ["template_start", "known_ones"], ["start"]),
                helper.make_node("Add", ["start", "shift"], ["place"]),
                helper.make_node("Where", ["seen2", "place", "nan3"], ["points"]),
                helper.make_node("ReduceMin", ["prediction", "last"], ["expected"], keepdims=0),
                helper.make_node("Slice", ["topography", "beside", "fourth", "axes"], ["stale4"]),
                helper.make_node("Reshape", ["stale4", "flat"], ["stale_count"]),
                helper.make_node("Less", ["names", "stale_count"], ["is_stale"]),
                helper.make_node("Cast", ["is_stale"], ["stale"], to=TensorProto.UINT8),
                helper.make_node("Identity", ["straight"], ["warp"]),
                helper.make_node("Identity", ["prediction"], ["estimate"]),
                helper.make_node("Add", ["prediction", "nan3"], ["by_neighbours"]),
                helper.make_node("Add", ["noughts", "template_pixel"], ["error"]),
                helper.make_node("ReduceMax", ["template_start", "last"], ["started"], keepdims=0),
                helper.make_node("Cast", ["contact_view"], ["contact"], to=TensorProto.FLOAT),
                helper.make_node("Mul", ["contact", "gain"], ["share"]),
                helper.make_node("Sub", ["one", "share"], ["lost"]),
                helper.make_node("Greater", ["lost", "limit"], ["real_contact_mask"]),
                helper.make_node("Cast", ["real_contact_mask"], ["touches"], to=TensorProto.FLOAT),
                helper.make_node("ReduceSum", ["touches", "image"], ["real_area_px"], keepdims=0),
                helper.make_node("Gemm", ["middle", "topography_to_contact"], ["center"], transB=1),
                helper.make_node("Cast", ["seen"], ["status"], to=TensorProto.UINT8),
            ],
            {
                "contact_view": (pixel, view),
                "topography_view": (pixel, view),
                "prediction": ("float", (1, POINTS, 2)),
                "topography_to_contact": ("float", (2, 3)),
                "limit": ("float", (1,)),
                "gain": ("float", view),
                "template_pixel": ("float", (1, 1)),
                "template_start": ("float", (1, POINTS, 2)),
            },
            {
                "real_area_px": ("float", (1,)),
                "center": ("float", (1, 2)),
                "points": ("float", (1, POINTS, 2)),
                "error": ("float", (1, POINTS)),
                "started": ("float", (1, POINTS)),
                "status": ("uint8", (1, POINTS)),
                "expected": ("float", (1, POINTS)),
                "real_contact_mask": ("bool", view),
                "stale": ("uint8", (1, POINTS)),
                "warp": ("float", (1, POINTS, 2, 2)),
                "estimate": ("float", (1, POINTS, 2)),
                "by_neighbours": ("float", (1, POINTS, 2)),
            },
            {
                **corner_constants,
                "names": names,
                "last": np.array([2]),
                "image": np.array([1, 2, 3]),
                "nan3": np.full((1, 1, 1), np.nan, np.float32),
                "second": np.array([0, 1]),
                "third": np.array([1, 2]),
                "beside": np.array([0, 2]),
                "fourth": np.array([1, 3]),
                "straight": np.broadcast_to(np.eye(2, dtype=np.float32), (1, POINTS, 2, 2)).copy(),
                "flat3": np.array([1, 1, 1]),
                "rest": np.full(1, 90, np.float32),
                "quarter": np.full(1, 0.25, np.float32),
                "nothing": np.zeros(1, np.float32),
                "noughts": np.zeros((1, POINTS), np.float32),
                "one": np.ones(1, np.float32),
                "middle": np.array([[WIDTH / 2, HEIGHT / 2, 1]], np.float32),
            },
        ),
        "search": _model(  # finds nothing
            [
                helper.make_node("Add", ["points", "prediction"], ["both"]),
                helper.make_node("Add", ["both", "nan3"], ["found"]),
            ],
            {
                **dict.fromkeys(("key_view", "topography_view"), (pixel, view)),
                **dict.fromkeys(("points", "prediction"), ("float", (1, RENEWED, 2))),
            },
            {"found": ("float", (1, RENEWED, 2))},
            {"nan3": np.full((1, 1, 1), np.nan, np.float32)},
        ),
        "renew": _model(
            [
                helper.make_node("Slice", ["warp", "nought", "one1", "row"], ["across"]),
                helper.make_node("Squeeze", ["across", "row"], ["by"]),
                helper.make_node("Add", ["points", "by"], ["template_start"]),
            ],
            {"points": ("float", (1, RENEWED, 2)), "warp": ("float", (1, RENEWED, 2, 2))},
            {"template_start": ("float", (1, RENEWED, 2))},
            {"nought": np.array([0]), "one1": np.array([1]), "row": np.array([2])},
        ),
        "fields": _model(
            [
                helper.make_node("IsNaN", ["reference"], ["unknown"]),
                helper.make_node("Where", ["unknown", "zeros", "reference"], ["known"]),
                helper.make_node("Add", ["known", "one"], ["next_reference"]),
                helper.make_node("ReduceMax", ["known", "last"], ["divergence"], keepdims=0),
                helper.make_node("ReduceMax", ["chosen", "last"], ["curl"], keepdims=0),
            ],
            dict.fromkeys(("points", "reference", "chosen"), ("float", (1, POINTS, 2))),
            {
                **dict.fromkeys(("divergence", "curl"), ("float", (1, POINTS))),
                "next_reference": ("float", (1, POINTS, 2)),
            },
            {
                "last": np.array([2]),
                "zeros": np.zeros((1, POINTS, 2), np.float32),
                "one": np.ones(1, np.float32),
            },
        ),
    }


def _model(
    nodes: list[onnx.NodeProto],
    inputs: dict[str, tuple[str, tuple[int, ...]]],
    outputs: dict[str, tuple[str, tuple[int, ...]]],
    constants: dict[str, np.ndarray[Any, Any]],
) -> onnx.ModelProto:
    infos = [
        [helper.make_tensor_value_info(name, _OF_TYPE[kind], shape) for name, (kind, shape) in side.items()]
        for side in (inputs, outputs)
    ]
    tensors = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    graph = helper.make_graph(nodes, "tiny", infos[0], infos[1], tensors)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
