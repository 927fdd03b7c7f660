"""Types of pixels that readers of recordings admit, each with the type in which engines compute.

The compiled kernels take every one of the latter (`kernels.declarations.FRAME_KINDS`, which a test compares).
"""

COMPUTED_TYPES = {"uint8": "uint8", "uint16": "uint16", "float32": "float32", "float64": "float32"}
