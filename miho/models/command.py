"""An external program as a model, which exchanges files in a temporary folder for each call.

`miho.models` does not export this model, so that a configuration from an untrusted source cannot
run a program.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO, ClassVar

import numpy as np

from miho.models.model import ExternalModel
from miho.quantities import Array
from miho.validate import positive

PARAMETERS, INPUTS, OUTPUT = "parameters.json", "inputs.csv", "output.txt"
TAIL, WIDTH = 4000, 200
"""Bytes at the end of a program's messages that are read, and characters that are shown."""


@dataclass(frozen=True)
class CommandModel(ExternalModel):
    """A program that computes the output (N,) at one configuration.

    The program runs without a shell in a temporary folder, which is removed afterwards. It reads
    parameters.json (numbers by name) and inputs.csv (a header, then the columns with 17 digits),
    and writes output.txt (one number per row). A call has no value if the program fails, takes too
    long or writes anything else. `predict` then gives NaN, or raises ValueError with the reason if
    no call of this model has succeeded yet.

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
    _succeeded: ClassVar[bool] = False

    def __post_init__(self) -> None:
        positive("seconds", self.seconds)
        positive("step", self.step)
        if isinstance(self.command, str) or not self.command:
            raise ValueError(
                f"command is {self.command!r}; expected a list of the program and its arguments"
            )

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Return the outputs (n, N) of parameter rows (n, d), with one run of the program each."""
        outputs = np.full((len(thetas), inputs[0].size), np.nan)
        failures = list[_FailedCall]()
        for theta, output in zip(thetas, outputs, strict=True):
            try:
                output[:] = self._run(theta, inputs)
                object.__setattr__(self, "_succeeded", True)
            except _FailedCall as failure:
                failures.append(failure)
        if failures and not self._succeeded:
            raise ValueError(str(failures[0]))
        return outputs

    def _run(self, theta: Array, inputs: Sequence[Array]) -> Array:
        """The output (N,) of one run; raises _FailedCall with the reason if it has none."""
        rows, program = inputs[0].size, Path(self.command[0]).name
        with TemporaryDirectory(prefix="miho-") as folder, TemporaryFile() as messages:
            values = dict(zip(self.parameters, theta.tolist(), strict=True))
            Path(folder, PARAMETERS).write_text(json.dumps(values), encoding="utf-8")
            header = ",".join(self.inputs)
            columns = np.column_stack(inputs)
            np.savetxt(Path(folder, INPUTS), columns, "%.17g", ",", header=header, comments="")
            try:
                ended = subprocess.run(
                    list(self.command), cwd=folder, timeout=self.seconds, check=False,
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=messages,
                )  # fmt: skip
            except subprocess.TimeoutExpired:
                raise _FailedCall(f"{program} took longer than {self.seconds:g} s") from None
            except OSError as error:
                raise ValueError(
                    f"command: cannot run {self.command[0]!r}: {error.strerror}; give the path "
                    "of an executable program"
                ) from None
            if ended.returncode:
                code = ended.returncode
                end = f"exit code {code}" if code > 0 else f"signal {-code}"
                reason = "".join(f": {line}" for line in _last_line(messages))
                raise _FailedCall(f"{program} ended with {end}{reason}")
            try:
                words = Path(folder, OUTPUT).read_text(encoding="utf-8").split()
                output = np.array([float(word) for word in words])
            except FileNotFoundError:
                raise _FailedCall(f"{program} wrote no {OUTPUT}") from None
            except ValueError as error:
                raise _FailedCall(f"{program} wrote more than numbers: {error}") from None
        if output.shape != (rows,):
            raise _FailedCall(
                f"{program} wrote {output.size} numbers to {OUTPUT}; expected {rows}, one per row"
            )
        return output


class _FailedCall(Exception):  # noqa: N818 -- ends a call, and no caller sees it
    """A run of the program gave no output."""


def _last_line(file: IO[bytes]) -> list[str]:
    """A list of the last nonempty line of a program's messages, shortened; [] if there is none."""
    file.seek(0, os.SEEK_END)
    file.seek(max(0, file.tell() - TAIL))
    lines = file.read().decode(errors="replace").split("\n")
    return [line.strip()[:WIDTH] for line in lines if line.strip()][-1:]
