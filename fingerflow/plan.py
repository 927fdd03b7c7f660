"""From the outputs that were asked for to the stages that are needed, and no other."""

from collections.abc import Iterable
from difflib import get_close_matches

from fingerflow.errors import FingerflowError
from fingerflow.stages import contact, deformation, loading, slip, tracking

#: What each stage gives, and which stages it needs, in the order in which they run.
STAGES: dict[str, tuple[frozenset[str], tuple[str, ...]]] = {
    "loading": (loading.GIVES, ()),
    "contact": (contact.GIVES, ("loading",)),
    "tracking": (tracking.GIVES, ("contact",)),
    "displacement": (deformation.DISPLACEMENT_GIVES, ("tracking",)),
    "fields": (deformation.FIELDS_GIVE, ("displacement",)),
    "strain": (deformation.STRAIN_GIVES, ("displacement",)),
    "slip": (slip.GIVES, ("loading", "contact", "tracking")),
}

OUTPUTS = tuple(sorted(name for gives, _ in STAGES.values() for name in gives))


def plan(
    outputs: Iterable[str] | None, has_topography: bool, has_forces: bool, is_slip: bool = False
) -> tuple[str, ...]:
    """The stages that give these outputs, in order; None asks for everything that the scene allows, and for slip only
    where the scene says that it is about it: in a press there is none to judge.

    Raises FingerflowError for an output that does not exist or that the scene cannot give.
    """
    if outputs is None:
        return tuple(
            name
            for name in STAGES
            if name in ("loading", "contact") or (has_topography and (name != "slip" or is_slip))
        )
    needed: set[str] = set()
    for output in outputs:
        stage = next((name for name, (gives, _) in STAGES.items() if output in gives), None)
        if stage is None:
            close = get_close_matches(output, OUTPUTS, n=1)
            hint = f"did you mean {close[0]!r}? " if close else ""
            raise FingerflowError(f"there is no output {output!r}; {hint}the outputs are {', '.join(OUTPUTS)}")
        if stage == "loading" and not has_forces:
            raise FingerflowError(f"the output {output!r} needs forces, and the scene has no [forces] table")
        _need(stage, needed)
    if "tracking" in needed and not has_topography:
        raise FingerflowError(
            "outputs that follow the skin need the topographic view, and the scene has no [views.topography] table; "
            f"without it the outputs are {', '.join(sorted(contact.GIVES | loading.GIVES))}"
        )
    return tuple(name for name in STAGES if name in needed)


def _need(stage: str, needed: set[str]) -> None:
    needed.add(stage)
    for earlier in STAGES[stage][1]:
        _need(earlier, needed)
