"""Processing stages of the pipeline; `all_stages` finds every stage class defined in the folders of this package."""

from functools import cache
from importlib import import_module
from pkgutil import walk_packages

from fingerflow.pipeline.stages.stage import Stage


@cache
def all_stages(instead: tuple[str, ...] = ()) -> tuple[type[Stage], ...]:
    """Return all stage classes, sorted by dependency: every stage comes after the stages that it needs.

    `instead` names the alternative implementations that replace their base stages.
    """
    for module in walk_packages(__path__, f"{__name__}."):
        import_module(module.name)
    stands_in = {
        kind.place(): kind
        for stage in Stage.__subclasses__()
        for kind in stage.__subclasses__()
        if kind.name in instead
    }
    found: list[type[Stage]] = []

    def add(stage: type[Stage]) -> None:
        taken = stands_in.get(stage, stage)
        for earlier in (*taken.after, *taken.beside):
            add(earlier)
        if taken not in found:
            found.append(taken)

    for stage in sorted(Stage.__subclasses__(), key=lambda stage: stage.name):
        add(stage)
    return tuple(found)
