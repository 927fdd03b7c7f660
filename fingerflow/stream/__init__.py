"""One step of a live stream as torch modules without branches on data: what is exported to ONNX, and its reference.

The rooms beside hold the same algorithms for recordings, with loops that end when a point has converged or a region is
filled. Here every step has a fixed number of operations. What does not change from frame to frame is computed by
modules of its own: the light by `background`, the templates of the points by `key`.
"""
