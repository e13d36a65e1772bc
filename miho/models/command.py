"""A model that is a program: files in, numbers out, in a folder of its own for each call.

Not among the names of `miho.models`, so that no configuration, which may come from somebody else,
can name a program to run.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from miho.models.model import ExternalModel
from miho.quantities import Array
from miho.validate import positive

PARAMETERS, INPUTS, OUTPUT = "parameters.json", "inputs.csv", "output.txt"


@dataclass(frozen=True)
class CommandModel(ExternalModel):
    """A program that computes the output (N,) at one configuration.

    command: the program and its arguments, run without a shell in an empty folder that is removed
        afterwards. It finds there parameters.json, numbers by name, and inputs.csv, a header and
        the columns to 17 digits; it writes output.txt, a number for each row.
    seconds: after which it is killed.
    step: of the central differences, relative to the parameter (or 1 for 0).

    A call that fails, takes too long or writes something else has no value (NaN); one where the
    program is not found raises ValueError.
    """

    command: Sequence[str]
    inputs: Mapping[str, str]
    parameters: Mapping[str, str]
    output: str
    seconds: float = 60.0
    step: float = 1e-3
    name: str = "command"

    def __post_init__(self) -> None:
        positive("seconds", self.seconds)
        positive("step", self.step)
        if isinstance(self.command, str) or not self.command:
            raise ValueError(
                f"command is {self.command!r}; expected a list: the program, then each argument"
            )

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Outputs (n, N) of parameter rows (n, d), one run of the program for each."""
        return np.array([self._run(theta, inputs) for theta in thetas])

    def _run(self, theta: Array, inputs: Sequence[Array]) -> Array:
        rows = inputs[0].size
        with tempfile.TemporaryDirectory(prefix="miho-") as folder:
            values = dict(zip(self.parameters, theta.tolist(), strict=True))
            Path(folder, PARAMETERS).write_text(json.dumps(values), encoding="utf-8")
            header = ",".join(self.inputs)
            columns = np.column_stack(inputs)
            np.savetxt(Path(folder, INPUTS), columns, "%.17g", ",", header=header, comments="")
            try:
                subprocess.run(
                    list(self.command), cwd=folder, timeout=self.seconds, check=True,
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )  # fmt: skip
                output = np.array(Path(folder, OUTPUT).read_text(encoding="utf-8").split(), float)
            except (FileNotFoundError, PermissionError) as error:
                if error.filename == self.command[0]:
                    raise ValueError(
                        f"command: {self.command[0]!r} cannot be run: {error.strerror}"
                    ) from None
                return np.full(rows, np.nan)
            except (subprocess.SubprocessError, ValueError):
                return np.full(rows, np.nan)
        return output if output.shape == (rows,) else np.full(rows, np.nan)
