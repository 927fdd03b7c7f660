"""Short digests: names for content that tell one from another."""

import hashlib
import json
from collections.abc import Iterable
from typing import Any


def digest_of(*parts: Any) -> str:
    """Of what JSON can hold."""
    return digest_of_bytes([json.dumps(parts, sort_keys=True).encode()])


def digest_of_bytes(parts: Iterable[bytes | memoryview]) -> str:
    """Of bytes, one after another."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()[:16]
