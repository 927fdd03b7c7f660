"""Binary format for metadata and arrays in one HTTP response, which a browser reads without parsing numbers."""

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fingerflow.schema.json_value import json_value

# Names of the types for which JavaScript has typed arrays.
_KINDS = {"u1": "uint8", "i4": "int32", "f4": "float32", "f8": "float64"}


def packed(facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return metadata and arrays as bytes: length of a JSON text, the text, and the arrays that it lists.

    The length is a little-endian uint32, followed by 4 zeros.

    The text and each array are padded to 8 bytes.

    Raises:
        ValueError: the dtype of an array is not uint8, int32, float32 or float64.
    """
    whole = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    for name, array in whole.items():
        if array.dtype.str[1:] not in _KINDS:
            raise ValueError(f"{name} is {array.dtype}; one of {', '.join(_KINDS.values())} can be sent")
    listed = [{"name": n, "type": _KINDS[a.dtype.str[1:]], "shape": a.shape} for n, a in whole.items()]
    text = json.dumps({**json_value(facts), "arrays": listed}).encode()
    blocks = [struct.pack("<I", len(text)), b"\0" * 4, text, b"\0" * (-len(text) % 8)]
    for array in whole.values():
        blocks += [array.tobytes(), b"\0" * (-array.nbytes % 8)]
    return b"".join(blocks)
