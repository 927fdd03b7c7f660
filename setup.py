"""Builds the compiled kernels, `fingerflow._kernels`; everything else about the package is in pyproject.toml.

A plain C library that `fingerflow.kernels` opens with ctypes: no Python header, no binding generator, no torch. It is
made of every source in `kernels`; hot ones, which say so in their first line, are compiled once an instruction set: in
a wheel for every set, in an editable install for those of this processor. Objects are kept in `build/kernels` and used
again while sources and options are the same. Where no compiler is found the install goes on without the library.
"""

import hashlib
import os
import platform
import runpy
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

KERNELS = Path("kernels")
# The first line of a source that is compiled once an instruction set; some need no exact agreement between the sets.
EXACT = "// build: each instruction set"
ROUNDED = f"{EXACT}, fused"

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
FEATURES = runpy.run_path(str(KERNELS / "generate_sets.py"))["FEATURES"]  # which the library asks a processor for
GNU_SETS = {name: [f"-m{one}" for one in features] for name, features in FEATURES.items()}
GNU_SETS["avx512"].append("-mprefer-vector-width=512")
ON_X86 = platform.machine().lower() in ("x86_64", "amd64")
if ON_X86:  # where processors run the baseline alone only if they are older than 2013
    GNU_SETS["baseline"].append("-O2")
MSVC_FLAGS = ["/std:c++17", "/O2", "/EHsc", "/fp:precise"]
MSVC_SETS = {"baseline": [], "avx2": ["/arch:AVX2"], "avx512": ["/arch:AVX512"]}


class BuildKernels(build_ext):
    def finalize_options(self) -> None:
        self.build_temp = self.build_temp or str(Path("build", "kernels"))  # of an editable install too
        super().finalize_options()
        self.in_source = bool(self.inplace)  # setuptools resets it for the build

    def build_extension(self, ext: Extension) -> None:
        folder = Path(self.build_temp)
        folder.mkdir(parents=True, exist_ok=True)
        for path in KERNELS.glob("generate_*.py"):
            generator = runpy.run_path(str(path))
            (folder / generator["GENERATES"]).write_text(generator["source"](), encoding="utf-8")
        microsoft = self.compiler.compiler_type == "msvc"
        flags, sets = (MSVC_FLAGS, MSVC_SETS) if microsoft else (GNU_FLAGS, GNU_SETS)
        names = [name for name in sets if ON_X86 or name == "baseline"]
        if not microsoft and (self.editable_mode or self.in_source):
            names = names[: sets_of_this_processor(self.compiler.compiler_so[:1])]
        macros = [("FINGERFLOW_X86", "1")] if ON_X86 else []
        once = [*macros, ("FINGERFLOW_SETS", str(len(names)))]
        includes = [str(KERNELS), str(folder)]
        headers = b"".join(path.read_bytes() for where in includes for path in sorted(Path(where).glob("*.h")))

        hot = (EXACT, ROUNDED)
        plain = [str(folder / "entries.cpp"), *(path for path in sources() if first_line(path) not in hot)]
        jobs = [(path, folder, once, flags) for path in plain]
        for number, name in enumerate(names):
            known = [*macros, ("FINGERFLOW_SETS", str(number + 1))] if number else once  # the same with fewer sets
            named = [*known, ("FINGERFLOW_ISA", name)]
            fused = [] if microsoft else ["-ffp-contract=fast"]
            for line, contract in ((EXACT, []), (ROUNDED, fused)):
                options = [*flags, *sets[name], *contract]
                jobs += [(path, folder / name, named, options) for path in sources() if first_line(path) == line]

        def compiled(job: tuple[str, Path, list[tuple[str, str]], list[str]]) -> list[str]:
            path, output, defined, options = job
            objects = self.compiler.object_filenames([path], output_dir=str(output))
            command = repr((vars(self.compiler), defined, options)).encode()
            digest = hashlib.sha256(command + headers + Path(path).read_bytes()).hexdigest()
            stamp = output / f"{Path(path).stem}.sha256"  # of what the object was compiled from
            if not (stamp.exists() and stamp.read_text() == digest and Path(objects[0]).exists()):
                stamp.unlink(missing_ok=True)
                self.compiler.compile([path], str(output), defined, includes, extra_postargs=options)
                stamp.write_text(digest)
            return objects

        for path, output, _, _ in jobs:  # the compiler makes them too, but not from several threads at once
            (output / path).parent.mkdir(parents=True, exist_ok=True)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            objects = [name for names in pool.map(compiled, jobs) for name in names]
        library = self.get_ext_fullpath(ext.name)
        Path(library).parent.mkdir(parents=True, exist_ok=True)
        self.compiler.link_shared_object(
            objects, library, extra_postargs=[] if microsoft else ["-pthread"], target_lang="c++"
        )


def sets_of_this_processor(compiler: list[str]) -> int:
    """Return how many of the instruction sets, from the first, the compiler says this processor has; all if unknown."""
    command = [*compiler, "-march=native", "-dM", "-E", "-xc++", os.devnull]
    try:
        macros = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    except (OSError, subprocess.CalledProcessError):
        return len(FEATURES)
    return sum(all(f"__{feature.upper()}__" in macros for feature in features) for features in FEATURES.values())


def sources() -> list[str]:
    return sorted(str(path) for path in KERNELS.glob("*.cpp"))


def first_line(path: str) -> str:
    return Path(path).read_text(encoding="utf-8").partition("\n")[0]


setup(
    ext_modules=[Extension("fingerflow._kernels", sources(), language="c++", optional=True)],
    cmdclass={"build_ext": BuildKernels},
)
