"""HTML file that redirects a browser to the page, so that no command line contains the token."""

import html
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory


def redirect(address: str) -> str:
    """Return an HTML page that redirects to an address, with an empty icon so that the browser requests none."""
    leads = f'<meta http-equiv="refresh" content="0;url={html.escape(address)}">'
    return f'<!doctype html>{leads}<link rel="icon" href="data:,"><title>fingerflow</title>'


@contextmanager
def redirect_file(address: str) -> Iterator[Path]:
    """Yield a temporary HTML file that redirects to an address and that no other user can read.

    Every user of a computer can list the command line of a browser, which holds what the browser was told to open.
    """
    with TemporaryDirectory(prefix="fingerflow-") as folder:  # only its owner may enter
        path = Path(folder) / "open.html"
        path.write_text(redirect(address), encoding="utf-8")
        yield path
