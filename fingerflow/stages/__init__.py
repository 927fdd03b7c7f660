"""The stages: every file of this folder that defines a `Stage` is one, found here by its class."""

from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from fingerflow.stages.stage import Stage


@cache
def all_stages() -> tuple[type[Stage], ...]:
    """The stages in an order in which each comes behind those that it needs."""
    for module in iter_modules(__path__):
        import_module(f"{__name__}.{module.name}")
    found: list[type[Stage]] = []

    def add(stage: type[Stage]) -> None:
        for earlier in (*stage.after, *stage.beside):
            add(earlier)
        if stage not in found:
            found.append(stage)

    for stage in sorted(Stage.__subclasses__(), key=lambda stage: stage.name):
        add(stage)
    return tuple(found)
