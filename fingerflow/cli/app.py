"""Define the Typer application of all commands, and the options that several commands share."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(
    help="Contact area, skin motion and strain from recordings of a fingertip on glass.", no_args_is_help=True
)
INTERRUPTED = 130  # exit status of an interrupted command: 128 + SIGINT, as in shells
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines, and no progress bar.")]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace a file that this command has not written; never an input.")
]

Format = Annotated[
    str | None, typer.Option("--format", help="Of figures: pdf, svg, png, or several with commas between; default png.")
]
Width = Annotated[
    str | None,
    typer.Option(
        "--width",
        help="Of figures on paper, such as 85mm, 8.5cm or 3.3in; default 170mm for several panels, 85mm for one. "
        "Panels without room beside each other stand below each other.",
    ),
]


def run_scene(scene: Any, outputs: list[str] | None, quiet: bool, **options: Any) -> Any:
    """Run `fingerflow.process` on a scene for the variables `outputs`, all for None, with a progress bar unless
    `quiet`; torch is imported only here.
    """
    from fingerflow.pipeline.run import process

    return process(scene, outputs, progress=not quiet, **options)


def scene_in(path: Path) -> Any:
    """Return the scene in a scene file, or the settings with which a result was computed."""
    from fingerflow.results.result import is_result, open_result
    from fingerflow.schema.scene import load_scene, scene_of_settings

    if path.suffix not in (".h5", ".hdf5", ".nc", ".zarr") and not is_result(path):
        return load_scene(path)
    with open_result(path) as stored:
        return scene_of_settings(stored.attrs["settings"])


def result_in(path: Path) -> Any:
    """Return a result or the results folder of a stream; for a scene file result.h5 beside it."""
    from fingerflow.results.result import load_result
    from fingerflow.results.stream_result import open_stream

    if path.is_dir() and path.suffix != ".zarr":
        return open_stream(path)
    return load_result(path.parent / "result.h5" if path.suffix == ".toml" else path)


def figure_files(formats: str | None, width: str | None) -> Any:
    """Return the `FigureFiles` for the options --format and --width; matplotlib is imported only here."""
    from fingerflow.plot.figure_files import FigureFiles

    return FigureFiles.parse(formats or "png", width)


def tell(facts: Any, text: str, as_json: bool) -> None:
    """Print `facts` as JSON if `as_json`, else `text` for readers."""
    typer.echo(json.dumps(facts, indent=1) if as_json else text)


def tell_facts(facts: dict[str, Any], as_json: bool) -> None:
    """Print facts by name as JSON if `as_json`, else one per line."""
    tell(facts, "\n".join(f"{name:18} {value}" for name, value in facts.items()), as_json)


def _tell_version(requested: bool) -> None:
    if requested:
        from fingerflow import __version__

        typer.echo(f"fingerflow {__version__}")
        raise typer.Exit


@app.callback()
def _root_options(
    version: Annotated[
        bool, typer.Option("--version", callback=_tell_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass
