"""Log of the player, and collection of its warnings, which become a part of the results."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

log = logging.getLogger("fingerflow.player")
_MOST = 100  # of the same stream, each only once


@contextmanager
def logged_warnings() -> Iterator[list[str]]:
    """Yield a list to which each different warning of the package's log is added until the end of the context."""
    sentences: list[str] = []

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            sentence = record.getMessage()
            if sentence not in sentences and len(sentences) < _MOST:
                sentences.append(sentence)

    collector, package = Collector(logging.WARNING), logging.getLogger("fingerflow")
    package.addHandler(collector)
    try:
        yield sentences
    finally:
        package.removeHandler(collector)
