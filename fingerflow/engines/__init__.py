"""Engines: what computes one frame for the tracker. One interface (`engine`), arrays of NumPy in and out.

`native` calls the compiled library and needs no torch, `torch` runs the modules of `graphs` on any device, `onnx` runs
the same modules exported. All give the same numbers, to rounding.
"""
