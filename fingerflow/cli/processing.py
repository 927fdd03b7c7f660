"""Commands that compute results of a scene (`process`) and list result variables (`outputs`)."""

import json
from pathlib import Path
from typing import Annotated

import typer

from fingerflow.cli.app import AsJson, Overwrite, app, run_scene, scene_in, tell
from fingerflow.errors import FingerflowError


@app.command()
def process(
    scene: Annotated[
        Path | None, typer.Argument(help="A scene file, or a result; with --from the scene of that result.")
    ] = None,
    variables: Annotated[
        list[str] | None,
        typer.Option(
            "--variable",
            "-v",
            help="A variable that is wanted, as `fingerflow outputs` names it; may be repeated. Default: all.",
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Result file; default result.h5 beside the scene.")
    ] = None,
    earlier: Annotated[
        Path | None,
        typer.Option(
            "--from",
            help="A result of the same recording: what does not depend on the settings that have changed since is "
            "taken from there, and only the rest is computed. It may be the file that is written.",
        ),
    ] = None,
    device: Annotated[str, typer.Option(help="auto, cpu, cuda ...")] = "auto",
    engine: Annotated[
        str,
        typer.Option(
            help="native: the compiled library; torch; onnx: graphs by ONNX Runtime; auto: native, else torch."
        ),
    ] = "auto",
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Process the recording of a scene and save the result."""
    from fingerflow.results.result import scene_of

    if scene is None:
        if earlier is None:
            raise FingerflowError("name a scene file, or a result by --from whose scene is computed again")
        scene = scene_of(earlier)
    path = output or scene.parent / "result.h5"
    loaded = scene_in(scene)
    result = run_scene(
        loaded, variables, quiet=as_json, device=device, engine=engine, to=path, overwrite=overwrite, earlier=earlier
    )
    warnings = json.loads(result.attrs["warnings"])
    facts = {"result": str(path), "variables": sorted(map(str, result.data_vars)), "warnings": warnings}
    lines = []
    if earlier is not None:
        facts["taken_over"] = taken = json.loads(result.attrs["taken_over"])
        lines = [f"taken from {earlier}: {', '.join(taken['stages']) or 'nothing'}"]
        lines += [f"computed: {stage}, since {why}" for stage, why in taken["computed"].items()]
    if not as_json:
        for warning in warnings:
            typer.echo(f"warning: {warning}", err=True)
    tell(facts, "\n".join([*lines, f"result: {path}"]), as_json)


@app.command()
def outputs(
    names: Annotated[list[str] | None, typer.Argument(help="Of variables, or parts of names. Default: all.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the variables that can be computed: unit, dimensions, stage, definition and equation of each."""
    from fingerflow.pipeline.dictionary import as_text, dictionary

    rows = [row for row in dictionary() if not names or any(name in row["name"] for name in names)]
    if not rows:
        raise FingerflowError(f"no variable is called {' or '.join(names or ())}; `fingerflow outputs` lists all")
    tell(rows, "\n".join(map(as_text, rows)), as_json)
