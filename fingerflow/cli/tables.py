"""Commands that export results to files for other programs."""

from pathlib import Path
from typing import Annotated

import typer

from fingerflow.cli.app import Overwrite, app, result_in

Result = Annotated[
    Path, typer.Argument(help="A result file, the results folder of a stream, or a scene beside its result.h5.")
]


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

    tables.export_table(result_in(result), table, rows, variables, overwrite)
    typer.echo(f"{table} was written")


@app.command("export-map")
def export_map(
    result: Result,
    variable: Annotated[str, typer.Argument(help="With a value for each point or triangle, such as divergence.")],
    picture: Annotated[Path, typer.Argument(help="A .tif file, for ImageJ, or a .csv file.")],
    step_mm: Annotated[float, typer.Option(help="Between the places of the grid, on the glass.")] = 0.1,
    overwrite: Overwrite = False,
) -> None:
    """Export a variable as maps on a regular grid of the glass, one map per frame."""
    from fingerflow.results import tables

    tables.export_map(result_in(result), picture, variable, step_mm, overwrite)
    typer.echo(f"{picture} was written")
