"""Closing of a source with a time limit."""

from __future__ import annotations

import logging
import threading

from fingerflow.errors import first_line
from fingerflow.player.sources.source import Source

log = logging.getLogger("fingerflow.player")


def close_within(seconds: float, source: Source) -> None:
    """Close a source; log a warning if that fails, and abandon it if it takes longer than `seconds`."""

    def close() -> None:
        try:
            source.close()
        except Exception as error:
            log.warning("closing the source: %s", first_line(error))

    closing = threading.Thread(target=close, name="close", daemon=True)
    closing.start()
    closing.join(seconds)
    if closing.is_alive():
        log.warning("closing the source takes more than %.0f s: it is left behind", seconds)
