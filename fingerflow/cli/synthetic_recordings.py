"""Commands that write synthetic recordings with known truth."""

import shutil
from pathlib import Path
from typing import Annotated, Any

import typer

from fingerflow.cli.app import AsJson, app, run_scene, tell
from fingerflow.errors import FingerflowError
from fingerflow.schema.unfinished import unfinished

_DEMO_FILES = {
    *("scene.toml", "frames.npy", "empty.npy", "dark.npy", "forces.csv", "truth.json"),
    *("result.h5", "report.html", "overlay.mp4"),
}


@app.command()
def demo(
    folder: Annotated[Path, typer.Argument(help="Where to write.")] = Path("fingerflow-demo"), as_json: AsJson = False
) -> None:
    """Simulate a press, process it, and compare with its known truth."""
    from fingerflow.report import write_report
    from fingerflow.results.result import save_result
    from fingerflow.schema.scene import load_scene
    from fingerflow.synthetic import Press, rebuild_scene, write_recording
    from fingerflow.synthetic.comparison_with_truth import as_text, compare

    if folder.exists():
        _remove_demo(folder)
    write_recording(folder, Press())
    scene = load_scene(folder / "scene.toml")
    result = run_scene(scene, None, quiet=as_json)
    save_result(result, folder / "result.h5")
    rows = compare(result, rebuild_scene(folder))
    report = write_report(result, scene, folder, rows)
    facts = {"report": str(report), "comparison": rows}
    tell(facts, f"{as_text(rows)}\n\nresult: {folder / 'result.h5'}\nreport: {report}", as_json)


@app.command()
def simulate(
    kind: Annotated[
        str,
        typer.Argument(help="press, chain-press (skin moves as a skin chain under friction), slide or partial-slip"),
    ],
    folder: Path,
    skin: Annotated[
        str | None,
        typer.Option(
            help="loop, whorl or arch: a fingerprint with minutiae and pores, whose ridges break at the border of the "
            "contact. Default: even rings of ridges, whole up to the border."
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            "--print",
            help="A picture of a fingerprint, dark ridges on bright glass, as the skin. Where it is blank, and beyond "
            "it, the skin is smooth and never touches. It is copied into the folder: the truth needs it.",
        ),
    ] = None,
    dpi: Annotated[float | None, typer.Option(help="Pixels an inch of that picture. Default: 500.")] = None,
    friction: Annotated[float | None, typer.Option(help="Coefficient of a chain-press. Default: 0.2.")] = None,
) -> None:
    """Write a synthetic recording with known truth, and a scene file for it."""
    from dataclasses import replace

    from fingerflow import synthetic

    kinds: dict[str, type[synthetic.SyntheticScene]] = {"press": synthetic.Press, "chain-press": synthetic.ChainPress}
    kinds |= {"slide": synthetic.Slide, "partial-slip": synthetic.PartialSlip}
    if kind not in kinds:
        raise FingerflowError(f"{kind!r} cannot be simulated; choose one of {', '.join(kinds)}")
    if skin is not None and picture is not None:
        raise FingerflowError("--skin and --print are two skins; give one of them")
    if dpi is not None and picture is None:
        raise FingerflowError("--dpi is the resolution of a picture; give the picture by --print")
    if picture is not None:
        scene = synthetic.scene_of_print(kinds[kind], picture, **({} if dpi is None else {"dpi": dpi}))
    else:
        texture: dict[str, Any] = {} if skin is None else {"texture": synthetic.FingerprintTexture(pattern=skin)}
        scene = kinds[kind](**texture)
    if friction is not None:
        if not isinstance(scene, synthetic.ChainPress):
            raise FingerflowError(f"--friction {friction:g} is of a chain-press; a {kind} has none that moves its skin")
        if not 0 <= friction < float("inf"):
            raise FingerflowError(f"--friction {friction:g}: a coefficient is 0 or more")
        scene = replace(scene, friction=friction)
    synthetic.write_recording(folder, scene)
    typer.echo(f'{folder} was written; process it with: fingerflow process "{folder / "scene.toml"}"')


def _remove_demo(folder: Path) -> None:
    """Remove the files of an earlier demo; if the folder has other files, raise FingerflowError and remove nothing."""
    for name in _DEMO_FILES:
        unfinished(folder / name)  # removes the files that an aborted demo left
    strange = sorted(path.name for path in folder.iterdir() if path.name not in _DEMO_FILES)
    if strange or not (folder / "truth.json").exists():
        problem = f"holds {', '.join(strange[:3])}" if strange else "is no earlier demo"
        raise FingerflowError(f"{folder} exists and {problem}; give another folder, or remove it")
    shutil.rmtree(folder)
