"""Commands for deployment bundles, which process live streams."""

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fingerflow.cli.app import AsJson, app, tell
from fingerflow.errors import FingerflowError

if TYPE_CHECKING:
    from fingerflow.player.live_forces import LiveForces


@app.command()
def export(
    recipe: Annotated[Path, typer.Argument(help="A recipe file, such as export/exact.toml.")],
    bundle: Annotated[Path, typer.Option("--output", "-o", help="The folder to write.")],
    as_json: AsJson = False,
) -> None:
    """Export a recipe to a deployment bundle: ONNX graphs, compared with torch, and the player."""
    from fingerflow.export import as_text, export_bundle

    rows = export_bundle(recipe, bundle, progress=not as_json)
    facts = {"bundle": str(bundle), "differences": rows}
    tell(facts, f"{as_text(rows)}\n\nbundle: {bundle}", as_json)


@app.command(
    add_help_option=False,  # the player answers --help itself
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True},
)
def stream(context: typer.Context) -> None:
    """Process a camera, recording or synthetic stream with a bundle; options: fingerflow stream BUNDLE --help."""
    from fingerflow.player import main as play

    raise typer.Exit(play(context.args, prog="fingerflow stream", forces_of=_recorded_forces))


def _recorded_forces(file: Path) -> "LiveForces | None":
    """Return the forces of the scene in a file as `process` computes them; log the reason and return None if they
    cannot be read.
    """
    from fingerflow.pipeline.run import process
    from fingerflow.player.live_forces import LiveForces
    from fingerflow.schema.scene import load_scene

    try:
        scene = load_scene(file)
        names = ["normal_force", *(["tangential_force"] if scene.has("forces.tangential") else [])]
        result = process(scene, names)
    except FingerflowError as error:
        logging.getLogger("fingerflow.player").warning("%s; the forces are unknown", error)
        return None
    return LiveForces(int(result["frame"][0]), {name: result[name].values for name in names})
