"""Profiles: sets of scene keys by which published analyses count."""

from collections.abc import Mapping
from typing import Any

from fingerflow.schema.scene_tables import SCENE

PROFILES: dict[str, dict[str, dict[str, Any]]] = {
    # Supplement of Willemet et al. 2021, with Otsu's threshold at the largest force as in the lab's script. Divergence
    # counts since onset in the dilated contact; strain and energy as in `PrintedStrainStage`. The printed median of 9
    # px is that of `printed_real_contact_area` alone: of narrow ridges, as where friction is low, it leaves nothing.
    "willemet_2021": {
        "contact": {"threshold": "reference_frame", "gross_radius_px": 8},
        "tracking": {"points": 700, "forward_backward_limit_px": 1.0, "points_from": "enhanced", "template": "previous",
                     "direction": "forward"},
        "fields": {"reference": "dilated_onset", "strain": "as_printed", "young_modulus_mpa": 1.0,
                   "poisson_ratio": 0.4, "depth_mm": 2.0},
    },
}  # fmt: skip
#: Outputs that scenes of a profile compute beside the usual ones.
OUTPUTS = {
    "willemet_2021": frozenset(("printed_strain", "printed_strain_energy", "printed_real_contact_area",
                                "printed_global_displacement")),
}  # fmt: skip


def with_profile(written: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables and keys of a scene file with those of its `profile`, which take the place of defaults: files
    that `fingerflow init` writes state them all. Other values stay; `SceneCheck` refuses them.
    """
    result = dict(written)
    for name, keys in PROFILES.get(str(written.get("profile")), {}).items():
        stated = written.get(name, {})
        if isinstance(stated, Mapping):
            usual = {key: SCENE[name].keys[key].left_out() for key in keys}
            result[name] = {**stated, **{key: keys[key] for key in keys if stated.get(key, usual[key]) == usual[key]}}
    return result
