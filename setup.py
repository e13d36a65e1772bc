"""Builds the machine that runs formulas, `miho/core`; all else is in pyproject.toml.

Without a C compiler, or one that does not know the extension's code, the library is installed
without the machine, and works all the same.
"""

from __future__ import annotations

import os
import shutil
import sys
import sysconfig
import tempfile
import zlib
from pathlib import Path
from typing import Any

from setuptools import Extension, setup
from setuptools._distutils.ccompiler import new_compiler
from setuptools._distutils.errors import CompileError, DistutilsError
from setuptools._distutils.sysconfig import customize_compiler
from setuptools.command.build_ext import build_ext

CORE = Path("miho/core")
TEXTS = [path.read_bytes().replace(b"\r\n", b"\n") for path in sorted(CORE.glob("[!.]*.[ch]"))]
SOURCES = zlib.crc32(b"".join(TEXTS))
"""Checksum by which `miho.core.tape` recognizes a machine that was built from other sources."""
FLAGS = [
    "-std=gnu11", "-O2", "-g0", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math",
    "-fopenmp-simd", "-fvisibility=hidden", "-fno-wrapv", "-fno-asynchronous-unwind-tables",
]  # fmt: skip
"""No product and sum is fused, so that every processor gives the same bits; no function gives way
to one of its name in another library; counters of loops do not wrap, as Python's own flags would
have them. Only the loops marked by `omp simd` have to be vectorised, and nothing unwinds the stack,
so that the extension is small."""
WINDOWS = os.name == "nt"
if WINDOWS:
    unknown = {"-g0", "-fvisibility=hidden", "-fno-asynchronous-unwind-tables"}
    FLAGS = [f"/clang:{flag}" for flag in FLAGS if flag not in unknown]
LIMITED = not sysconfig.get_config_var("Py_GIL_DISABLED")
"""One build serves all versions of Python; those without a lock have no stable interface."""


def choose(compiler: Any) -> None:
    """Take clang-cl on Windows: Microsoft's own compiler has no vector code of this kind."""
    if WINDOWS:
        compiler.initialize()
        compiler.cc = shutil.which("clang-cl")
        if compiler.cc is None:
            raise CompileError("there is no clang-cl")


class Build(build_ext):
    """Compiles with the compiler of `choose`."""

    def build_extensions(self) -> None:
        """Build all extensions; setuptools calls it."""
        choose(self.compiler)
        super().build_extensions()


def can_compile() -> bool:
    """Whether there is a compiler for these flags, and Python's headers."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "probe.c")
        source.write_text("#include <Python.h>\nint probe(void) { return 0; }\n", encoding="ascii")
        compiler = new_compiler()
        try:
            customize_compiler(compiler)
            choose(compiler)
            compiler.compile(
                [str(source)],
                output_dir=folder,
                include_dirs=[sysconfig.get_path("include")],
                extra_postargs=FLAGS,
            )
        except (CompileError, DistutilsError, OSError):
            return False
    return True


machine = Extension(
    "miho.core._machine",
    [str(CORE / f"{name}.c") for name in
     ("module", "module_arrays", "module_climb", "module_many", "module_search", "module_track",
      "module_trajectory", "module_triangular", "evaluate", "climb", "triangular", "steps",
      "descent", "bracket", "many", "many_descent", "many_starts", "track", "mixture",
      "trajectory", "one_row", "level_baseline", "level_avx2", "level_avx512")],
    depends=[str(path) for path in sorted(CORE.glob("*.h"))],
    extra_compile_args=FLAGS,
    extra_link_args=["-Wl,-s"] if sys.platform == "linux" else [],  # without names of functions
    define_macros=[("MIHO_SOURCES", f"{SOURCES}u")]
    + ([("Py_LIMITED_API", "0x030b0000")] if LIMITED else []),
    py_limited_api=LIMITED,
    optional=True,
)  # fmt: skip

if can_compile():
    setup(
        cmdclass={"build_ext": Build},
        ext_modules=[machine],
        options={"bdist_wheel": {"py_limited_api": "cp311"}} if LIMITED else {},
    )
else:
    sys.stderr.write(
        "miho: no C compiler with Python's headers; formulas will run in NumPy, slower\n"
    )
    setup()
