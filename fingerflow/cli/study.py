"""Commands for studies, which compute one table from many recordings."""

from pathlib import Path
from typing import Annotated

import typer

from fingerflow.cli.app import INTERRUPTED, Format, Width, app, figure_files
from fingerflow.errors import FingerflowError

study = typer.Typer(
    help="Many recordings: from a folder to a table of trials, its statistics and figures.", no_args_is_help=True
)
app.add_typer(study, name="study")
Manifest = Annotated[Path, typer.Argument(help="study.toml, or its folder.")]
Scheduler = Annotated[
    str | None,
    typer.Option(
        help="Address of a Dask scheduler (tcp://host:8786), or a deployment class by its name "
        "(dask_jobqueue.SLURMCluster), with the settings of Dask's own configuration. Default: this computer."
    ),
]
Workers = Annotated[int | None, typer.Option(min=1, help="Processes; default one a core.")]
Only = Annotated[str | None, typer.Option(help="Trials whose names fit a pattern, such as '03_*' for participant 03.")]


@study.command()
def init(
    folder: Annotated[Path, typer.Argument(help="The folder of the recordings.")],
    answers: Annotated[
        Path | None, typer.Option(help="A CSV file: participant, trial, answer (1 or 0), and what else is known.")
    ] = None,
) -> None:
    """Write study.toml and trials.csv for the recordings found in a folder."""
    from fingerflow.study.init import init_study

    trials, to_fill_in = init_study(folder, answers)
    manifest = folder / "study.toml"
    typer.echo(f"{manifest} and trials.csv were written: {trials} trials")
    for lacking in to_fill_in:
        typer.echo(f"to be filled in: {lacking}")
    typer.echo(f"then: fingerflow study run {manifest}")


@study.command()
def run(
    manifest: Manifest,
    scheduler: Scheduler = None,
    workers: Workers = None,
    only: Only = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be run and why, and run nothing.")] = False,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Also trials that failed, though nothing of them has changed.")
    ] = False,
) -> None:
    """Process all trials of a study whose result is missing or out of date, and write the table of trials."""
    from fingerflow.study.manifest import load_manifest
    from fingerflow.study.run_study import plan_run, run_study
    from fingerflow.study.table import write_tables

    loaded = load_manifest(manifest)
    typer.echo(loaded.matched, nl=bool(loaded.matched))
    if dry_run:
        planned = plan_run(loaded, only, retry_failed)
        for entry, _, why in planned:
            typer.echo(f"{entry.name}: {why}")
        typer.echo(f"{len(planned)} of {len(loaded.trials)} trials would be run")
        return
    summary = run_study(loaded, scheduler, workers, only, retry_failed)
    typer.echo(str(summary))
    typer.echo(f"table: {write_tables(loaded)[0]}")
    if summary.interrupted:
        raise typer.Exit(INTERRUPTED)


@study.command()
def report(
    manifest: Manifest,
    scheduler: Scheduler = None,
    workers: Workers = None,
    formats: Format = None,
    width: Width = None,
) -> None:
    """Write the page of a study (trials, figures and statistics) from the results of `fingerflow study run`."""
    from fingerflow.study.cluster import Interrupted
    from fingerflow.study.manifest import load_manifest
    from fingerflow.study.report import write_study_report

    files, loaded = figure_files(formats, width), load_manifest(manifest)
    typer.echo(loaded.matched, nl=bool(loaded.matched))
    try:
        page = write_study_report(loaded, scheduler, workers, figure_files=files)
    except Interrupted as stop:
        typer.echo(f"no page: {stop}", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(f"page: {page}")


@study.command()
def simulate(
    folder: Annotated[Path, typer.Argument(help="A new folder.")],
    participants: Annotated[int, typer.Option(min=2, help="Half of them with softer skin.")] = 4,
    trials: Annotated[int, typer.Option(min=1, help="Pairs of presses, of each participant in each condition.")] = 2,
    seed: int = 0,
) -> None:
    """Write small synthetic recordings of a study with known truth, and the answers of a simulated observer.

    Each trial is a pair of presses: a reference, and a comparison on glass that vibrates.
    """
    from fingerflow.study.simulated import write_recordings
    from fingerflow.study.simulated_trials import Design

    if folder.exists():
        raise FingerflowError(f"{folder} exists already; name another folder")
    write_recordings(folder, Design(participants=participants, trials=trials, seed=seed))
    typer.echo(f'{folder} was written; then: fingerflow study init "{folder}" --answers "{folder / "answers.csv"}"')
