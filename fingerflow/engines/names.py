"""Names of what ONNX Runtime runs and with what: known without it."""

#: Graphs of a bundle that an engine needs, in the order in which they can run.
GRAPHS = (
    "light",
    "contact",
    "threshold",
    "noise",
    "detect",
    "spline",
    "prepare",
    "renew",
    "track",
    "track_few",
    "support",
    "correct",
    "outliers",
    "search",
    "windows",
    "fields",
    "fields_entered",
    "fit",
)

#: Execution providers by short name, in the order in which they are tried.
PROVIDERS = {
    "tensorrt": "TensorrtExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "directml": "DmlExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "cpu": "CPUExecutionProvider",
}
