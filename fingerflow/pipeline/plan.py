"""Plan of a run: the ordered stages that are needed for the requested outputs."""

from collections.abc import Collection
from typing import NamedTuple

from fingerflow.errors import FingerflowError, did_you_mean
from fingerflow.pipeline.stages import all_stages
from fingerflow.pipeline.stages.stage import Stage
from fingerflow.schema import profiles
from fingerflow.schema.scene import Scene
from fingerflow.schema.scene_kinds import KINDS
from fingerflow.schema.variable_record import Variable
from fingerflow.schema.variables import by_name

#: All variables that stages give, by name.
VARIABLES: dict[str, Variable] = by_name(*(stage.gives for stage in all_stages()))
#: Names of all outputs that may be requested, sorted.
OUTPUTS = tuple(sorted(VARIABLES))
_REMEDIES = {
    "dense_flow_slip": 'comes by dense flow, and the scene does not set [slip] displacement = "dense_flow"',
    "undistorted": "is not corrected for the lens that [calibration] intrinsics states",
}


class Plan(NamedTuple):
    """Plan of a run: stages sorted by dependency, and names of the requested variables and of their deviations."""

    stages: tuple[type[Stage], ...]
    requested: frozenset[str]

    def passes(self) -> list[list[type[Stage]]]:
        """Return the planned stages as a list of groups, each of which is run in one pass over the frames.

        Stages of one pass depend on each other only through their steps (`Stage.same_pass`); a stage in `Stage.after`
        belongs to an earlier pass.
        """
        number: dict[type[Stage], int] = {}
        for stage in self.stages:
            later = [number[earlier] + 1 for earlier in stage.after if earlier in number]
            number[stage] = max([0, *later, *(number[neighbour] for neighbour in stage.same_pass)])
        last = max(number.values(), default=-1)
        return [[stage for stage in self.stages if number[stage] == k] for k in range(last + 1)]


def plan(outputs: Collection[str] | None, scene: Scene) -> Plan:
    """Return the plan of a run: the stages for the requested outputs, and all stages on which these depend.

    None requests all that the scene's kind computes by default and its settings allow. Raises FingerflowError for an
    output that does not exist or that the scene cannot give.
    """
    stage_of = {variable.name: stage for stage in all_stages() for variable in stage.gives}
    keys = {name: (*VARIABLES[name].needs, *_needed_keys(stage)) for name, stage in stage_of.items()}
    lacking = {name: [key for key in needed if not scene.has(key)] for name, needed in keys.items()}
    named = frozenset(profiles.OUTPUTS.get(scene.profile or "", ()) if outputs is None else outputs)
    if outputs is None:
        default = [name for name, variable in VARIABLES.items() if variable.unasked or name in named]
        without = KINDS[scene.kind].without
        outputs = [name for name in default if not lacking[name] and stage_of[name].name not in without]
    for name in outputs:
        if name not in VARIABLES:
            hint = did_you_mean(name, OUTPUTS)
            raise FingerflowError(f"there is no output {name!r}; {hint}the outputs are {', '.join(OUTPUTS)}")
        if missing := lacking[name]:
            possible = ", ".join(output for output in OUTPUTS if not lacking[output])
            why = _REMEDIES.get(missing[0], f"needs {missing[0]}, which the scene does not have")
            raise FingerflowError(f"the output {name!r} {why}; without it the outputs are {possible}")
    needed = {stage_of[name] for name in outputs}
    for stage in reversed(all_stages()):  # a stage comes after those that it needs
        if stage in needed:
            needed.update(stage.after, stage.same_pass)
    run = tuple(stage.variant(scene) for stage in all_stages() if stage in needed)
    stored = {name.removesuffix("_std") for name in named.union(*(stage.reads for stage in run))}
    return Plan(run, frozenset(name for name in VARIABLES if name.removesuffix("_std") in stored))


def _needed_keys(stage: type[Stage]) -> list[str]:
    """Return the dotted scene keys, such as "calibration.mm_per_px", that a stage or one of the stages on which it
    depends needs.
    """
    return [*stage.needs, *(key for needed in (*stage.after, *stage.same_pass) for key in _needed_keys(needed))]
