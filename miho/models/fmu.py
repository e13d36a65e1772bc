"""An FMU (Functional Mock-up Unit) as a model, simulated by FMPy."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import sys
import tempfile
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from miho.models.equations import NO_UNIT
from miho.models.layout import OUTPUT, Layout, check_scales
from miho.models.model import ExternalModel
from miho.models.time_step import time_step_remarks
from miho.models.traced import Remade
from miho.quantities import Array
from miho.regular_file import check_regular
from miho.validate import positive_settings, whole

Names = Sequence[str] | Mapping[str, str]
REAL = ("Real", "Float64", "Float32")
CO_SIMULATION, MODEL_EXCHANGE = "CoSimulation", "ModelExchange"
INTERFACES = {CO_SIMULATION: "coSimulation", MODEL_EXCHANGE: "modelExchange"}
FATAL = 4
"""Status after which no function of an instance may be called."""
STREAMS = (1, 2)
"""File descriptors of standard output and error."""
LISTED = 20
"""Largest number of an FMU's names in a message."""
ROUNDING = 1e-6
"""Tolerance of times, as a fraction of a step."""
ORDER = 2
"""Order of convergence in the step size, for inputs held at their mean over a step."""


@dataclass(frozen=True)
class FmuModel(Remade, ExternalModel):
    """Outputs of an FMU (co-simulation or model exchange; FMI 2, others untested) over time.

    The FMU is unzipped and instantiated once, and reset between simulations. A simulation that
    fails or takes too long gives NaN, or raises ValueError with the reason if no simulation of this
    model has succeeded yet. Output that the FMU prints is discarded. The binary of the FMU runs in
    this process without a sandbox: if it crashes, the process ends. Use FMUs from trusted sources
    only.

    Parameters
    ----------
    path : str
        The .fmu file.
    identified : sequence of str or Mapping[str, str]
        Parameters and start values of states of the FMU that are parameters of this model. A
        mapping gives the FMU's name for each name in this model.
    outputs : sequence of str
        Variables of the FMU. The rows of several outputs are stacked, with a column `output` that
        counts them from 0 (`miho.data.stacked`).
    columns : sequence of str or Mapping[str, str], optional
        Inputs of the FMU that are columns of the data, linear between rows; a mapping as above.
        Other inputs keep their start values.
    scales : sequence of float, optional
        Standard deviation of the error of each output, as in `Trajectory`.
    interface : {"CoSimulation", "ModelExchange"}, optional
        By default the first of these interfaces that the FMU has.
    substeps : int, optional
        Communication steps per median distance of rows. Outputs are linear between the steps. A
        co-simulation holds inputs over a step at their value in its middle.
    tolerance : float, optional
        Relative tolerance of FMPy's solver (CVODE), and of the FMU's solver if it supports this.
    seconds : float, optional
        Time limit of a simulation [s], checked at the end of each step.
    step : float, optional
        Step of central differences, relative to the parameter. A parameter that is 0 uses its
        start value, or 1.
    time : str, optional
        Name of the time column.
    units : Mapping[str, str], optional
        Units by name, which replace the units of the FMU.

    Raises
    ------
    ValueError
        If the file is not an FMU for this platform, or does not have one of the names.
    ImportError
        If FMPy is not installed.

    Examples
    --------
    >>> model = FmuModel(
    ...     "swing.fmu", identified=["k", "c"], outputs=["x"], columns=["force"]
    ... )  # doctest: +SKIP
    """

    path: str
    identified: Names
    outputs: Sequence[str]
    columns: Names = ()
    scales: Sequence[float] = ()
    interface: str = ""
    substeps: int = 1
    tolerance: float = 1e-8
    seconds: float = 60.0
    step: float = 1e-3
    time: str = "t"
    units: Mapping[str, str] = field(default_factory=dict)
    _succeeded: ClassVar[bool] = False

    def __post_init__(self) -> None:
        whole("substeps", self.substeps, 1)
        positive_settings(self, ("tolerance", "seconds", "step"))
        if self.interface not in ("", *self._interfaces):
            raise ValueError(
                f"interface is {self.interface!r}; {self.path} has {', '.join(self._interfaces)}"
            )
        if not self._parameters or not self.outputs:
            raise ValueError(
                f"{self.path}: expected at least one name in each of identified and outputs"
            )
        self._check("identified", self._parameters.values(), _is_set_before)
        self._check("columns", self._inputs.values(), lambda v: v.causality == "input")
        self._check("outputs", self.outputs, lambda v: v.causality != "input")
        strange = self.units.keys() - {*self.inputs, *self.parameters, *self.outputs}
        if strange:
            raise ValueError(
                f"units has {min(strange)!r}, which is not a name of this model; remove it"
            )
        check_scales(self.scales, [self._unit(name, name) for name in self.outputs])

    def _check(self, setting: str, names: Iterable[str], fits: Callable[[Any], bool]) -> None:
        fitting = [name for name, v in self._variables.items() if v.type in REAL and fits(v)]
        for name in names:
            if name not in fitting:
                listed = ", ".join(fitting[:LISTED]) + ", ..." * (len(fitting) > LISTED)
                raise ValueError(
                    f"{setting} has {name!r}; expected one of these variables of {self.path}: "
                    f"{listed or '(none)'}"
                )

    @cached_property
    def _parameters(self) -> dict[str, str]:
        """The FMU's names of the parameters, by their names in this model."""
        return _by_name(self.identified)

    @cached_property
    def _inputs(self) -> dict[str, str]:
        """The FMU's names of the columns, by their names in this model."""
        return _by_name(self.columns)

    @cached_property
    def _place(self) -> Path:
        """Absolute path, because runs may work in another folder."""
        return Path(self.path).absolute()

    @cached_property
    def _description(self) -> Any:
        """FMPy's description of the FMU: names, units, interfaces."""
        check_regular(self.path)
        fmpy = _fmpy()
        try:
            platforms = fmpy.supported_platforms(self._place)
            description = fmpy.read_model_description(self.path)
        except Exception as error:
            reason = " ".join(str(error).split())
            raise ValueError(f"{self.path}: cannot be read as an FMU: {reason}") from error
        if fmpy.platform not in platforms:
            raise ValueError(
                f"{self.path}: has binaries for {', '.join(platforms)}, not for {fmpy.platform}; "
                "export it with binaries for this platform"
            )
        return description

    @cached_property
    def _variables(self) -> dict[str, Any]:
        """Scalar variables of the FMU, by name."""
        return {v.name: v for v in self._description.modelVariables if not v.shape}

    @cached_property
    def _interfaces(self) -> list[str]:
        """Interfaces of the FMU."""
        return [name for name, key in INTERFACES.items() if getattr(self._description, key)]

    def _unit(self, name: str, variable: str) -> str:
        """Return the unit of a name: given by `units` or by the FMU, otherwise ""."""
        declared = self._variables[variable]
        unit = declared.unit or getattr(declared.declaredType, "unit", None)
        return self.units.get(name, _spelled(unit))

    @cached_property
    def inputs(self) -> Mapping[str, str]:
        """Units of the columns: time, inputs, and the number of the output."""
        return (
            {self.time: self.units.get(self.time, "s")}
            | {name: self._unit(name, own) for name, own in self._inputs.items()}
            | ({OUTPUT: NO_UNIT} if len(self.outputs) > 1 else {})
        )

    @cached_property
    def parameters(self) -> Mapping[str, str]:
        """Units by name."""
        return {name: self._unit(name, own) for name, own in self._parameters.items()}

    @property
    def output(self) -> str:
        """Unit of the outputs, "-" if they are divided by scales."""
        return NO_UNIT if self.scales else self._unit(self.outputs[0], self.outputs[0])

    @property
    def name(self) -> str:
        """Name of the file."""
        return re.sub(r"[^A-Za-z0-9_.-]", "_", Path(self.path).stem)

    @property
    def source(self) -> Path:
        """The file."""
        return Path(self.path)

    @property
    def typical(self) -> Array:
        """Absolute start values (d,), with 1 in place of 0."""
        starts = [self._variables[name].start for name in self._parameters.values()]
        return np.array([abs(float(start or 0.0)) or 1.0 for start in starts])

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Return the outputs (n, N) of parameter rows (n, d), with one simulation per row."""
        columns = dict(zip(self.inputs, inputs, strict=True))
        own = Layout(
            self.time, tuple(self._inputs), {}, (), len(self.outputs), None, 1, False, self.substeps
        )  # fmt: skip
        course = own.course(columns)
        if course.t.size < 2:
            raise ValueError(f"{self.name}: expected rows at two different times or more, got one")
        out = np.full((len(thetas), inputs[0].size), np.nan)
        reasons = list[str]()
        for theta, values in zip(thetas, out, strict=True):
            result = self._simulated(theta, course.t, course.u.T)
            if isinstance(result, str):
                reasons.append(result)
                continue
            object.__setattr__(self, "_succeeded", True)
            for k, name in enumerate(self.outputs):
                rows = course.output == k
                values[rows] = np.interp(columns[self.time][rows], result["time"], result[name])
                values[rows] /= self.scales[k] if self.scales else 1.0
        if reasons and not self._succeeded:
            raise ValueError(f"{self.name}: {reasons[0]}")
        return out

    def _simulated(self, theta: Array, t: Array, u: Array) -> Any:
        """Return FMPy's table of the outputs at all steps over the times t (N,).

        Inputs u (q, N) are linear between the times. If the simulation fails, the result is the
        reason.
        """
        interval = float(np.median(np.diff(t))) / self.substeps
        end = t[0] + interval * np.ceil((t[-1] - t[0]) / interval - ROUNDING)
        simulation = self._simulation
        instance, signals = simulation.ready(), None
        if self._inputs:
            # FMPy reads inputs at the beginning of a co-simulation step and holds them. Its solver
            # does not read inputs within its steps, but sets the time.
            co_simulation = simulation.interface == CO_SIMULATION
            ahead = interval / 2 if co_simulation else 0.0
            fields = [("time", float), *((name, float) for name in self._inputs.values())]
            signals = np.array(list(zip(t - ahead, *u, strict=True)), dtype=fields)
            if not co_simulation:
                variables = [self._variables[name] for name in self._inputs.values()]
                simulation.drive(variables, t, u)
        try:
            with _quiet():
                result = _fmpy().simulate_fmu(
                    simulation.folder, start_time=t[0], stop_time=end, output_interval=interval,
                    relative_tolerance=self.tolerance, record_events=False, timeout=self.seconds,
                    start_values=dict(zip(self._parameters.values(), theta.tolist(), strict=True)),
                    input=signals, output=self.outputs, fmi_type=simulation.interface,
                    model_description=self._description, fmu_instance=instance,
                )  # fmt: skip
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 -- FMPy raises any, also Exception itself
            simulation.failed(error)
            return " ".join(f"{type(error).__name__}: {error}".split())
        if result["time"][-1] < end - interval / 2:
            at = f"{self.time} = {result['time'][-1]:g}, before {end:g}"
            return f"the simulation stopped at {at}; its limit is {self.seconds:g} s"
        return result

    def remarks(self, theta: Array, noise: float | Array, *inputs: Array) -> list[str]:
        """Return a sentence if a halved step would change parameters noticeably."""
        return time_step_remarks(self, ORDER, theta, noise, *inputs)

    @cached_property
    def _simulation(self) -> _Simulation:
        return _Simulation(self._place, self._description, self.interface or self._interfaces[0])


class _Simulation:
    """An unzipped FMU and its instance; the folder is removed with the last reference."""

    def __init__(self, path: Path, description: Any, interface: str) -> None:
        self.folder: str = tempfile.mkdtemp(prefix="miho-")
        weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)
        self.interface, self._path, self._description = interface, path, description
        self._instance: Any = None
        _fmpy().extract(path, self.folder)

    def ready(self) -> Any:
        """Return the instance after a reset, or a new instance if the reset fails."""
        if self._instance is not None and not self._reset():
            self._instance = None
        if self._instance is None:
            try:
                with _quiet():
                    self._instance = _fmpy().instantiate_fmu(
                        self.folder, self._description, self.interface
                    )
            except Exception as error:
                reason = " ".join(str(error).split())
                raise ValueError(f"{self._path}: cannot be instantiated: {reason}") from error
        return self._instance

    def drive(self, variables: Sequence[Any], t: Array, u: Array) -> None:
        """Make the instance set the inputs u (q, N) over t (N,) with each setting of its time."""
        instance = self._instance
        setter = getattr(instance, f"set{variables[0].type}")
        references = [variable.valueReference for variable in variables]

        def set_time(time: float) -> None:
            type(instance).setTime(instance, time)
            setter(references, [float(np.interp(time, t, row)) for row in u])

        instance.setTime = set_time

    def failed(self, error: Exception) -> None:
        """Discard the instance after a fatal error."""
        if getattr(error, "status", None) == FATAL:
            self._instance = None

    def _reset(self) -> bool:
        try:
            self._instance.reset()
        except Exception:  # noqa: BLE001 -- reset is missing or fails
            with contextlib.suppress(Exception):
                self._instance.freeInstance()
            return False
        return True


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Discard printed output, also from C, and raise errors from a solver's callbacks."""
    unheard: list[BaseException | None] = []
    usual, sys.unraisablehook = sys.unraisablehook, lambda raised: unheard.append(raised.exc_value)
    saved, nowhere = [os.dup(stream) for stream in STREAMS], os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in STREAMS:
            os.dup2(nowhere, stream)
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        for stream, own in zip(STREAMS, saved, strict=True):
            os.dup2(own, stream)
            os.close(own)
        os.close(nowhere)
        sys.unraisablehook = usual
        if unheard and unheard[0] is not None:
            raise unheard[0]


def _fmpy() -> Any:
    try:
        import fmpy
    except ModuleNotFoundError as error:
        raise ImportError(
            f"FMUs need a library that is missing ({error.name}); pip install 'miho[fmu]'"
        ) from None
    return fmpy


def _by_name(names: Names) -> dict[str, str]:
    return dict(names) if isinstance(names, Mapping) else {name: name for name in names}


def _is_set_before(variable: Any) -> bool:
    """Return whether a variable may be set before a simulation (FMI 2.0.4, Sec. 2.2.7)."""
    starts = variable.start is not None or variable.initial == "exact"
    return bool(starts and variable.variability != "constant" and variable.causality != "input")


def _spelled(unit: str | None) -> str:
    """Return a unit of an FMU, for example N.m or m/s2, in the spelling of this package."""
    text = re.sub(r"(?<=[A-Za-z])(-?[0-9]+)", r"^\1", unit or "").replace(".", "*")
    return {"N*m": "Nm", "1": NO_UNIT}.get(text, text)
