"""Builds the compiled kernels, `fingerflow._kernels`; everything else about the package is in pyproject.toml.

A plain C library that `fingerflow.kernels` opens with ctypes: no Python header, no binding generator, no torch. Hot
sources are compiled once an instruction set. Where no compiler is found the install goes on without the library.
"""

import os
import platform
import runpy
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

KERNELS = Path("kernels")
PLAIN = [
    "area_medians",
    "components",
    "corners",
    "apparent_contact",
    "ellipse",
    "flow",
    "instruction_sets",
    "light_gain",
    "local_fit",
    "median",
    "morphology",
    "noise",
    "otsu",
    "parallel",
    "search",
    "skin_chain",
    "templates",
    "real_contact_mask",
    "triangle_strain",
]
# Compiled for every instruction set; some need no exact agreement between the sets.
EXACT = [
    "corners_rows",
    "ellipse_rows",
    "halve_rows",
    "median_band",
    "morphology_rows",
    "noise_rows",
    "real_contact_mask_rows",
]
ROUNDED = [
    "area_medians_block",
    "apparent_contact_cells",
    "flow_rows",
    "light_gain_rows",
    "local_fit_block",
    "search_points",
    "skin_chain_press",
    "templates_points",
    "triangle_strain_frame",
]

# -ffp-contract=off: a fused multiply-add rounds once where separate steps round twice, and not every set has it. Sums
# of hundreds of products may differ by that, and take half the time. -fno-trapping-math: a choice between two numbers
# may compute both, which no vector code can do without, and changes no number.
GNU_FLAGS = [
    "-std=c++17",
    "-O3",
    "-fvisibility=hidden",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-pthread",
    "-g0",
    "-fno-strict-aliasing",
]
GNU_SETS = {
    "baseline": [],
    "avx2": ["-mavx2", "-mfma"],
    "avx512": ["-mfma", "-mavx512bw", "-mavx512vl", "-mavx512dq", "-mprefer-vector-width=512"],
}
MSVC_FLAGS = ["/std:c++17", "/O2", "/EHsc", "/fp:precise"]
MSVC_SETS = {"baseline": [], "avx2": ["/arch:AVX2"], "avx512": ["/arch:AVX512"]}


class BuildKernels(build_ext):
    def build_extension(self, ext: Extension) -> None:
        folder = Path(self.build_temp)
        folder.mkdir(parents=True, exist_ok=True)
        for stem, generated in (("generate_median", "median_networks.h"), ("generate_limits", "tracking_limits.h")):
            runpy.run_path(str(KERNELS / f"{stem}.py"))["main"](str(folder / generated))
        microsoft = self.compiler.compiler_type == "msvc"
        flags, sets = (MSVC_FLAGS, MSVC_SETS) if microsoft else (GNU_FLAGS, GNU_SETS)
        on_x86 = platform.machine().lower() in ("x86_64", "amd64")
        macros = [("FINGERFLOW_X86", "1")] if on_x86 else []
        includes = [str(KERNELS), str(folder)]

        jobs = [(path, folder, macros, flags) for path in paths(PLAIN)]
        for name, more in sets.items():
            if on_x86 or name == "baseline":
                named = [*macros, ("FINGERFLOW_ISA", name)]
                fused = [] if microsoft else ["-ffp-contract=fast"]
                for stems, contract in ((EXACT, []), (ROUNDED, fused)):
                    jobs += [(path, folder / name, named, [*flags, *more, *contract]) for path in paths(stems)]

        def compiled(job: tuple[str, Path, list[tuple[str, str]], list[str]]) -> list[str]:
            path, output, defined, options = job
            return self.compiler.compile([path], str(output), defined, includes, extra_postargs=options)

        for _, output, _, _ in jobs:  # the compiler makes them too, but not from several threads at once
            (output / KERNELS).mkdir(parents=True, exist_ok=True)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            objects = [name for names in pool.map(compiled, jobs) for name in names]
        library = self.get_ext_fullpath(ext.name)
        Path(library).parent.mkdir(parents=True, exist_ok=True)
        self.compiler.link_shared_object(
            objects, library, extra_postargs=[] if microsoft else ["-pthread"], target_lang="c++"
        )


def paths(stems: list[str]) -> list[str]:
    return [str(KERNELS / f"{stem}.cpp") for stem in stems]


setup(
    ext_modules=[Extension("fingerflow._kernels", paths(PLAIN + EXACT + ROUNDED), language="c++", optional=True)],
    cmdclass={"build_ext": BuildKernels},
)
