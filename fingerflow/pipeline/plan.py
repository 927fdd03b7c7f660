"""Plan of a run: the ordered stages that are needed for the requested outputs."""

from collections.abc import Iterable
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
        return [
            [stage for stage in self.stages if number[stage] == k] for k in range(max(number.values(), default=-1) + 1)
        ]


def plan(outputs: Iterable[str] | None, scene: Scene) -> Plan:
    """Return the plan of a run: the stages for the requested outputs, and all stages on which these depend.

    None requests all that the scene's kind computes by default and its settings allow. Raises FingerflowError for an
    output that does not exist or that the scene cannot give.
    """
    stages = {stage: stage.variant(scene) for stage in all_stages()}
    if outputs is None:
        without = KINDS[scene.kind].without
        possible = [
            stage for base, stage in stages.items() if base.name not in without and not _missing_keys(stage, scene)
        ]
        also = profiles.OUTPUTS.get(scene.profile or "", frozenset())
        requested = [stage for stage in possible if any(one.unasked or one.name in also for one in stage.gives)]
        return _add_needs(requested, also, stages.values())
    names, stage_of = list(outputs), {variable.name: stage for stage in stages.values() for variable in stage.gives}
    for name in names:
        if name not in VARIABLES:
            hint = did_you_mean(name, OUTPUTS)
            raise FingerflowError(f"there is no output {name!r}; {hint}the outputs are {', '.join(OUTPUTS)}")
        stage = stage_of[name]
        lacking = [need for need in VARIABLES[name].needs if not scene.has(need)] or _missing_keys(stage, scene)
        if lacking:
            outputs = [output for output in OUTPUTS if not _missing_keys(stage_of[output], scene)]
            outputs = [output for output in outputs if all(map(scene.has, VARIABLES[output].needs))]
            why = _REMEDIES.get(lacking[0], f"needs {lacking[0]}, which the scene does not have")
            raise FingerflowError(f"the output {name!r} {why}; without it the outputs are {', '.join(outputs)}")
    return _add_needs([stage_of[name] for name in names], frozenset(names), stages.values())


def _add_needs(requested: Iterable[type[Stage]], named: frozenset[str], stages: Iterable[type[Stage]]) -> Plan:
    needed, ordered = set(requested), list(stages)
    for stage in reversed(ordered):  # a stage comes after those that it needs
        if stage in needed:
            needed.update(stage.after, stage.same_pass)
    run = tuple(stage for stage in ordered if stage in needed)
    stored = {name.removesuffix("_std") for name in named.union(*(stage.reads for stage in run))}
    return Plan(run, frozenset(name for name in VARIABLES if name.removesuffix("_std") in stored))


def _missing_keys(stage: type[Stage], scene: Scene) -> list[str]:
    """Return the dotted scene keys, such as "calibration.mm_per_px", that a stage or one of the stages on which it
    depends needs, and that the scene lacks.
    """
    lacking = [need for need in stage.needs if not scene.has(need)]
    return lacking + [key for needed in (*stage.after, *stage.same_pass) for key in _missing_keys(needed, scene)]
