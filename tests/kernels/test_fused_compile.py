"""Test that every Triton kernel compiles to machine code of a Jetson Orin and of an H100, without these GPUs."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("triton", reason="Triton is not installed: pip install fingerflow-engine[gpu]")
pytestmark = pytest.mark.long  # the compiler takes seconds a kernel

COMPILE = """
import sys
import triton
from importlib import import_module
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource

LARGEST_SHARED = 48 << 10  # bytes that a block has on every GPU
INTEGERS = (
    "recordings count total height width rows columns rounds memory half narrow_half broad_half positions_batch "
    "values_batch queries_batch noise_batch light_batch black_batch minimum_points references frames neighbours "
    "block kept"
)
NUMBERS = (
    "rounding forward_backward_limit mismatch_limit radius least_spread wide narrow broad "
    "width_1 width_2 width_3 width_4"
)
TYPES = {**dict.fromkeys(INTEGERS.split(), "i32"), **dict.fromkeys(NUMBERS.split(), "fp32")}
TILES = {"QUERIES": 16, "POINTS": 32}
OF_POINTS = {"apart": "*u8", "columns": "*fp32"}
OF_PIXELS = {"frames": "*u8", "mask": "*u8"}
OF_PAIRS = {"number": "*i64", "off": "*u8", "uncertain": "*u8"}


def tracking(window, ones, frames):
    own = {"lengths": "*i32", "status": "*u8", "frames": frames}
    return own, {"OWN_NOISE": window == 25, "WINDOW": window, "SIDE": 32, **dict.fromkeys(ones, 1)}


def medians(**constants):
    return OF_POINTS, {"NOISE": True, "APART": True, "MEASURE": 0, **constants}


KERNELS = {
    "fused_tracking": [
        ("_follow", *tracking(25, (), "*u8")),
        ("_follow", *tracking(11, ("recordings", "count", "rounds"), "*i32")),
    ],
    "fused_fits": [
        ("_fit", {"number": "*i64"}, {"COMPONENTS": c, "NOISES": n, **TILES}) for c, n in ((2, 4), (4, 0), (1, 1))
    ],
    "fused_medians": [
        ("_fit_positions", *medians(**TILES)),
        ("_fit_positions", *medians(**TILES, NOISE=False, APART=False, MEASURE=2)),
        ("_take_medians", *medians(POSITIONS=1024)),
        ("_take_medians", *medians(POSITIONS=1024, NOISE=False, APART=False, MEASURE=1)),
        ("_sum_errors", *medians(**TILES)),
    ],
    "fused_outliers": [
        (name, OF_PAIRS, {"POINTS": 32, "NEIGHBOURS": 16}) for name in ("_fit_slopes", "_compare", "_flag")
    ],
    "fused_pixels": [
        ("_sum_blocks", OF_PIXELS, {"COLUMNS": 64, "BLOCK": 16}),
        ("_find_mode", {}, {"BLOCKS": 2048}),
        ("_mark", OF_PIXELS, {"PIXELS": 1024, "HIGHEST": 255.0}),
    ],
    "fused_contact": [("_segment", {"mask": "*u8"}, {"CELL": 4, "ROWS": 16, "COLUMNS": 256})],
}
# Triton takes integers that are 1 for constants.
ONES = ("positions_batch", "queries_batch", "noise_batch", "light_batch", "black_batch", "references", "half")
place = "fingerflow.kernels.tensors." + sys.argv[1]
for capability, ones in ((87, ()), (90, ONES)):
    for name, own, constants in KERNELS[sys.argv[1]]:
        kernel = getattr(import_module(place), name)
        constants = {**constants, **dict.fromkeys([one for one in ones if one in kernel.arg_names], 1)}
        kinds = {**TYPES, **own, **dict.fromkeys(constants, "constexpr")}
        signature = {given: kinds.get(given, "*fp32") for given in kernel.arg_names}
        source = ASTSource(fn=kernel, signature=signature, constexprs=constants)
        made = triton.compile(source, target=GPUTarget("cuda", capability, 32))
        assert made.asm["cubin"]
        assert made.metadata.shared <= LARGEST_SHARED, (name, made.metadata.shared)
"""


@pytest.mark.parametrize(
    "module", ["fused_tracking", "fused_fits", "fused_medians", "fused_outliers", "fused_pixels", "fused_contact"]
)
def test_fused_kernels_compile_for_absent_gpus(module: str, tmp_path: Path) -> None:
    """The compiled kernel fits into the shared memory that a block has on every GPU."""
    environment = {key: value for key, value in os.environ.items() if key != "TRITON_INTERPRET"}
    environment["TRITON_CACHE_DIR"] = str(tmp_path)
    ended = subprocess.run(
        [sys.executable, "-c", COMPILE, module], capture_output=True, text=True, check=False, env=environment
    )
    assert ended.returncode == 0, ended.stderr
