"""HTML file that redirects the browser to the page, so that the access token is not visible in a command line."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from fingerflow.player.page_token import redirect


@contextmanager
def redirect_file(address: str) -> Iterator[Path]:
    """Yield a temporary HTML file that redirects to a URL and that other users cannot read.

    Every user of a computer can list the command line of a browser, which holds what the browser was told to open.
    """
    with TemporaryDirectory(prefix="fingerflow-") as folder:  # only its owner may read the folder
        path = Path(folder) / "open.html"
        path.write_text(redirect(address), encoding="utf-8")
        yield path
