"""Commands that export results to files for other programs."""

from pathlib import Path
from typing import Annotated

import typer

from fingerflow.cli.app import Overwrite, app

Result = Annotated[Path, typer.Argument(help="A result file, or the results folder of a stream.")]


@app.command("export-table")
def export_table(
    result: Result,
    table: Annotated[Path, typer.Argument(help="A .csv, .mat or .nwb file, or a .zarr folder.")],
    rows: Annotated[
        str,
        typer.Option(
            help="What is a row of a .csv: frame; point, one a point in each frame; or track, columns as napari's "
            "tracks have them: ID, t, y, x."
        ),
    ] = "frame",
    variables: Annotated[
        list[str] | None,
        typer.Option("--variable", "-v", help="A variable that is a column; may be repeated. Default: all."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Export a result as a CSV table (a row per frame, point or track step), or completely as .mat, .nwb or .zarr."""
    from fingerflow.results import tables
    from fingerflow.results.result import load_result
    from fingerflow.results.stream_result import open_stream

    source = open_stream(result) if result.is_dir() and result.suffix != ".zarr" else load_result(result)
    tables.export_table(source, table, rows, variables, overwrite)
    typer.echo(f"{table} was written")


@app.command("export-map")
def export_map(
    result: Annotated[Path, typer.Argument(help="A result file.")],
    variable: Annotated[str, typer.Argument(help="With a value for each point or triangle, such as divergence.")],
    picture: Annotated[Path, typer.Argument(help="A .tif file, for ImageJ, or a .csv file.")],
    step_mm: Annotated[float, typer.Option(help="Between the places of the grid, on the glass.")] = 0.1,
    overwrite: Overwrite = False,
) -> None:
    """Export a variable as maps on a regular grid of the glass, one map per frame."""
    from fingerflow.results import tables
    from fingerflow.results.result import load_result

    tables.export_map(load_result(result), picture, variable, step_mm, overwrite)
    typer.echo(f"{picture} was written")
