"""Command that reproduces both papers from simulated recordings."""

import os
from pathlib import Path
from typing import Annotated

import typer

from fingerflow.cli.app import app
from fingerflow.errors import FingerflowError
from fingerflow.schema.variable_record import IN_PERCENT


@app.command()
def reproduce(
    folder: Annotated[Path, typer.Argument(help="Where recordings, results and the page go; a run there goes on.")],
    paper: Annotated[
        str | None, typer.Option(help="slip (Terekhov & Hayward 2011) or press (Willemet et al. 2021). Default: both.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A small study of presses, in minutes.")] = False,
) -> None:
    """Simulate the experiments of both papers, measure them, and compare every published number with its result."""
    os.environ.pop(IN_PERCENT, None)  # removed before the units of the rows are read, as the papers print divergence in length ratios, not in percent
    from fingerflow.reproduce.both_papers import reproduce
    from fingerflow.reproduce.paper_page import TITLES

    if paper is not None and paper not in TITLES:
        raise FingerflowError(f"--paper {paper}: choose one of {', '.join(TITLES)}")
    typer.echo(f"page: {reproduce(folder, tuple(TITLES) if paper is None else (paper,), quick)}")
