"""Command that opens the page to set up scenes and view results."""

from pathlib import Path
from typing import Annotated

import typer

from fingerflow.cli.app import app


@app.command()
def view(
    path: Annotated[
        Path | None, typer.Argument(help="A scene file, a recording or a result. Default: scene.toml here.")
    ] = None,
    port: Annotated[int, typer.Option(help="Default: a free one.", min=0, max=65535)] = 0,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
) -> None:
    """Set up a scene and view its results on a local web page, which only this computer can open."""
    import webbrowser
    from contextlib import ExitStack

    from fingerflow.view import serve
    from fingerflow.view.redirect import redirect_file

    with ExitStack() as files:

        def tell(address: str) -> None:
            typer.echo(f"{address}\nCtrl+C ends it.")
            if browser:
                webbrowser.open(files.enter_context(redirect_file(address)).as_uri())

        serve(path, port, tell)
