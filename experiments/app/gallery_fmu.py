"""The FMU of the manual's gallery: a damped oscillator, compiled from its C source."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from importlib.util import find_spec
from pathlib import Path

from experiments.app.gallery_pages import FOLDER

SOURCES = FOLDER / "swing"
DESCRIPTION = "modelDescription.xml"
INTERFACES = ("CoSimulation", "ModelExchange")


def missing_for_fmu() -> str:
    """The reason why this machine cannot build or run the FMU; empty if it can."""
    if find_spec("fmpy") is None:
        return "FMPy is not installed; pip install 'miho[fmu]'"
    if not sys.platform.startswith("linux") or shutil.which("cc") is None:
        return "the FMU is built by a C compiler on Linux"
    return ""


def description(*interfaces: str) -> str:
    """The text of modelDescription.xml with only these interfaces."""
    text = (SOURCES / DESCRIPTION).read_text(encoding="utf-8")
    for name in set(INTERFACES).difference(interfaces):
        text = re.sub(rf"\s*<{name} [^>]*/>", "", text)
    return text


def build_fmu(path: Path, *interfaces: str) -> None:
    """Compile and pack the FMU with these interfaces, by default with both."""
    import fmpy  # of an extra

    headers = Path(fmpy.__file__).parent / "c-code"
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(path, "w") as archive:
        library = Path(folder, "swing.so")
        command = ["cc", "-shared", "-fPIC", "-O2", f"-I{headers}", str(SOURCES / "swing.c"), "-o"]
        subprocess.run([*command, str(library)], check=True)
        archive.writestr(DESCRIPTION, description(*(interfaces or INTERFACES)))
        archive.write(library, "binaries/linux64/swing.so")
