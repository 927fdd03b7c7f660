"""Short digests (hashes) that identify the content of files and settings."""

import hashlib
import json
from collections.abc import Iterable
from typing import Any


def digest_of(*parts: Any) -> str:
    """Return a digest (16 hexadecimal digits) of values that JSON can represent."""
    return digest_of_bytes([json.dumps(parts, sort_keys=True).encode()])


def digest_of_bytes(parts: Iterable[bytes | memoryview]) -> str:
    """Return a SHA-256 digest (16 hexadecimal digits) of a sequence of bytes objects."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()[:16]
