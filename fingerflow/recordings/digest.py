"""Short digests (hashes) that identify the content of files and settings."""

import hashlib
import json
from collections.abc import Iterable
from typing import Any


def digest_of(*parts: Any) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 hash of `parts`, written as JSON text with sorted keys."""
    return digest_of_bytes([json.dumps(parts, sort_keys=True).encode()])


def digest_of_bytes(parts: Iterable[bytes | memoryview]) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 hash of `parts`, hashed as one sequence of bytes."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()[:16]
