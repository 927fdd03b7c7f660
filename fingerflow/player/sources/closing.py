"""Lets go of a source, whatever it does then."""

from __future__ import annotations

import logging
import threading

from fingerflow.errors import first_line
from fingerflow.player.sources.source import Source

log = logging.getLogger("fingerflow.player")


def close_within(seconds: float, source: Source) -> None:
    """Closes a source; one that fails, or hangs for longer, is left behind with a warning."""

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
