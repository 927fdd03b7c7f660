"""Which variables a run is asked for."""

from fingerflow.pipeline.plan import plan
from fingerflow.schema.scene import Scene


def all_of_default_stages(scene: Scene) -> list[str]:
    """The variables of a default run, and those that its stages give only where somebody names them."""
    stages = plan(None, scene).stages
    return [one.name for stage in stages for one in stage.gives if all(map(scene.has, one.needs))]
