"""Variables that the page requests from a run."""

from fingerflow.pipeline.plan import plan
from fingerflow.schema.scene import Scene


def all_of_default_stages(scene: Scene) -> list[str]:
    """Return all variables that the stages of a default run can compute, including those computed only on request."""
    stages = plan(None, scene).stages
    return [one.name for stage in stages for one in stage.gives if all(map(scene.has, one.needs))]
