"""An external program as a model, which exchanges files in a temporary folder for each call.

`miho.models` does not export this model, so that a configuration from an untrusted source cannot
run a program.
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

    The program runs without a shell in a temporary folder, which is removed afterwards. It reads
    parameters.json (numbers by name) and inputs.csv (a header, then the columns with 17 digits),
    and writes output.txt (one number per row). A call gives NaN if the program fails, takes too
    long or writes anything else.

    Parameters
    ----------
    command : sequence of str
        The program and its arguments.
    inputs : Mapping[str, str]
        Units of the columns, by name.
    parameters : Mapping[str, str]
        Units of the parameters, by name.
    output : str
        Unit of the output.
    seconds : float, optional
        Time limit of a call [s], after which the program is killed.
    step : float, optional
        Step of central differences, relative to the parameter, or absolute if it is 0.
    name : str, optional
        Name of the model.

    Raises
    ------
    ValueError
        If settings are invalid, or if the program does not exist or is not executable.
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
                f"command is {self.command!r}; expected a list of the program and its arguments"
            )

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Return the outputs (n, N) of parameter rows (n, d), with one run of the program each."""
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
                        f"command: cannot run {self.command[0]!r}: {error.strerror}; give the path "
                        "of an executable program"
                    ) from None
                return np.full(rows, np.nan)
            except (subprocess.SubprocessError, ValueError):
                return np.full(rows, np.nan)
        return output if output.shape == (rows,) else np.full(rows, np.nan)
