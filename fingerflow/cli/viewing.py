"""The page to set up scenes and to look at results."""

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
    """Set up a scene and look at its results on a page that is served to this computer alone."""
    import webbrowser

    from fingerflow.view import serve

    def tell(address: str) -> None:
        typer.echo(f"{address}\nCtrl+C ends it.")
        if browser:
            webbrowser.open(address)

    serve(path, port, tell)
