"""HTML file that redirects the browser to the page, so that the access token is not visible in a command line."""

import html
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory


@contextmanager
def redirect_file(address: str) -> Iterator[Path]:
    """Yield a temporary HTML file that redirects to a URL and that other users cannot read.

    Every user of a computer can list the command line of a browser, which holds what the browser was told to open.
    """
    with TemporaryDirectory(prefix="fingerflow-") as folder:  # only its owner may read the folder
        path = Path(folder) / "open.html"
        leads = f'<meta http-equiv="refresh" content="0;url={html.escape(address)}">'
        path.write_text(f"<!doctype html>{leads}<title>fingerflow</title>", encoding="utf-8")
        yield path
