"""Engines: exchangeable back ends that compute contact, tracking and fields of frames for the tracker.

All have one interface (`engine`) with NumPy arrays in and out. `native` calls the compiled library and needs no torch,
`torch` runs the modules of `graphs` on any device, `onnx` runs the same modules exported. Their results agree to
rounding.
"""
