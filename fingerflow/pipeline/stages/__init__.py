"""Processing stages of the pipeline; `all_stages` finds every stage class defined in the folders of this package."""

from functools import cache
from importlib import import_module
from pkgutil import walk_packages

from fingerflow.pipeline.stages.stage import Stage


@cache
def all_stages() -> tuple[type[Stage], ...]:
    """Return all stage classes, sorted by dependency: every stage comes after the stages that it needs.

    A subclass of a stage is not listed: it runs instead of the stage where a scene selects it (`Stage.variant`).
    """
    for module in walk_packages(__path__, f"{__name__}."):
        import_module(module.name)
    ordered: list[type[Stage]] = []

    def add(stage: type[Stage]) -> None:
        for earlier in (*stage.after, *stage.same_pass):
            add(earlier)
        if stage not in ordered:
            ordered.append(stage)

    for stage in sorted(Stage.__subclasses__(), key=lambda stage: stage.name):
        add(stage)
    return tuple(ordered)
