"""An FMU as a model: a simulation behind the Functional Mock-up Interface, run by FMPy."""

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
from typing import Any

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
"""The status after which no function of an instance may be called."""
STREAMS = (1, 2)
"""Standard output and error, as C knows them."""
LISTED = 20
"""Names of an FMU that a message lists at most."""
ROUNDING = 1e-6
"""A time this close to a step, as a share of it, is at it."""
ORDER = 2
"""The error of inputs that are held over a step, at their mean, falls with this power of it."""


@dataclass(frozen=True)
class FmuModel(Remade, ExternalModel):
    """Outputs of an FMU (co-simulation or model exchange; FMI 2, others untested) over time.

        FmuModel("swing.fmu", identified=["k", "c"], outputs=["x"], columns=["force"])

    identified: parameters, and start values of states, that are parameters of this model; with a
        mapping, the FMU's names by those here.
    outputs: variables of the FMU. The data of several stand below each other, with a column
        `output` that counts them from 0 (`miho.data.stacked`).
    columns: inputs of the FMU that are columns of the data, straight from row to row; with a
        mapping, the FMU's names by those here. Other inputs keep their start values.
    scales: what each output is divided by, the standard deviation of its error, as of `Trajectory`.
    interface: CoSimulation or ModelExchange; empty for the first of these that the FMU has.
    substeps: communication steps from row to row, of the median distance of rows; outputs are
        straight between them. A co-simulation holds inputs over a step, at their value amid it.
    tolerance: relative, of FMPy's solver (CVODE), and of an FMU's own that heeds it.
    seconds: after which a simulation is given up, at the end of one of its steps.
    step: of the central differences, relative to the parameter (for 0, to its start value or 1).
    time: the column of time. units: by name, where they are not as the FMU says.

    The FMU is unzipped and instantiated once, and reset between simulations. One that fails, or
    takes too long, is NaN; what the FMU prints is dropped. Its binary runs in this process, with
    all that it may do: where it crashes, the process ends. Raises ValueError for a file that is no
    FMU for this platform and for names that it does not have, ImportError without FMPy.
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

    def __post_init__(self) -> None:
        whole("substeps", self.substeps, 1)
        positive_settings(self, ("tolerance", "seconds", "step"))
        if self.interface not in ("", *self._interfaces):
            raise ValueError(
                f"interface is {self.interface!r}; {self.path} has {', '.join(self._interfaces)}"
            )
        if not self._parameters or not self.outputs:
            raise ValueError(f"{self.path}: identified and outputs name at least one variable each")
        self._check("identified", self._parameters.values(), _is_set_before)
        self._check("columns", self._inputs.values(), lambda v: v.causality == "input")
        self._check("outputs", self.outputs, lambda v: v.causality != "input")
        strange = self.units.keys() - {*self.inputs, *self.parameters, *self.outputs}
        if strange:
            raise ValueError(f"units has {min(strange)!r}, which nothing here is called; remove it")
        check_scales(self.scales, [self._unit(name, name) for name in self.outputs])

    def _check(self, setting: str, names: Iterable[str], fits: Callable[[Any], bool]) -> None:
        fitting = [name for name, v in self._variables.items() if v.type in REAL and fits(v)]
        for name in names:
            if name not in fitting:
                listed = ", ".join(fitting[:LISTED]) + ", ..." * (len(fitting) > LISTED)
                raise ValueError(
                    f"{setting} has {name!r}; choose from what {self.path} has of that kind: "
                    f"{listed or 'nothing'}"
                )

    @cached_property
    def _parameters(self) -> dict[str, str]:
        """The FMU's names of the parameters, by those here."""
        return _by_name(self.identified)

    @cached_property
    def _inputs(self) -> dict[str, str]:
        """The FMU's names of the columns, by those here."""
        return _by_name(self.columns)

    @cached_property
    def _description(self) -> Any:
        """What FMPy reads of the FMU: names, units, interfaces."""
        check_regular(self.path)
        fmpy = _fmpy()
        try:
            platforms = fmpy.supported_platforms(self.path)
            description = fmpy.read_model_description(self.path)
        except Exception as error:
            reason = " ".join(str(error).split())
            raise ValueError(f"{self.path}: is no FMU that can be read: {reason}") from error
        if fmpy.platform not in platforms:
            raise ValueError(
                f"{self.path}: is made for {', '.join(platforms)}, not for {fmpy.platform}; export "
                "it with binaries for this platform"
            )
        return description

    @cached_property
    def _variables(self) -> dict[str, Any]:
        """The scalar variables of the FMU by name."""
        return {v.name: v for v in self._description.modelVariables if not v.shape}

    @cached_property
    def _interfaces(self) -> list[str]:
        """Those that the FMU has."""
        return [name for name, key in INTERFACES.items() if getattr(self._description, key)]

    def _unit(self, name: str, variable: str) -> str:
        """The unit of a name here: as given, or as the FMU says; "" where nobody says."""
        declared = self._variables[variable]
        simple = declared.declaredType
        unit = declared.unit or (simple.unit if simple is not None else None)
        return self.units.get(name, _spelled(unit))

    @cached_property
    def inputs(self) -> Mapping[str, str]:  # type: ignore[override]
        """Time, the columns, and which output it is where there are several."""
        return (
            {self.time: self.units.get(self.time, "s")}
            | {name: self._unit(name, own) for name, own in self._inputs.items()}
            | ({OUTPUT: NO_UNIT} if len(self.outputs) > 1 else {})
        )

    @cached_property
    def parameters(self) -> Mapping[str, str]:  # type: ignore[override]
        """Units by name."""
        return {name: self._unit(name, own) for name, own in self._parameters.items()}

    @property
    def output(self) -> str:  # type: ignore[override]
        """The unit of the outputs, "-" of those in multiples of their scales."""
        return NO_UNIT if self.scales else self._unit(self.outputs[0], self.outputs[0])

    @property
    def name(self) -> str:  # type: ignore[override]
        """The file's."""
        return re.sub(r"[^A-Za-z0-9_.-]", "_", Path(self.path).stem)

    @property
    def source(self) -> Path:  # type: ignore[override]
        """The file."""
        return Path(self.path)

    @property
    def typical(self) -> Array:
        """The sizes of the start values (d,), 1 for 0."""
        starts = [self._variables[name].start for name in self._parameters.values()]
        return np.array([abs(float(start or 0.0)) or 1.0 for start in starts])

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        """Outputs (n, N) of parameter rows (n, d) at input columns (N,), a simulation for each."""
        columns = dict(zip(self.inputs, inputs, strict=True))
        own = Layout(
            self.time, tuple(self._inputs), {}, (), len(self.outputs), None, 1, False, self.substeps
        )  # fmt: skip
        course = own.course(columns)
        if course.t.size < 2:
            raise ValueError(f"{self.name}: a simulation needs rows at two times at least")
        out = np.full((len(thetas), inputs[0].size), np.nan)
        for theta, values in zip(thetas, out, strict=True):
            result = self._simulated(theta, course.t, course.u.T)
            for k, name in enumerate(self.outputs if result is not None else ()):
                rows = course.output == k
                values[rows] = np.interp(columns[self.time][rows], result["time"], result[name])
                values[rows] /= self.scales[k] if self.scales else 1.0
        return out

    def _simulated(self, theta: Array, t: Array, u: Array) -> Any:
        """FMPy's table of the outputs at all steps from the first to the last of the times t (N,).

        Inputs u (q, N) are straight between these. None for a simulation that failed.
        """
        interval = float(np.median(np.diff(t))) / self.substeps
        end = t[0] + interval * np.ceil((t[-1] - t[0]) / interval - ROUNDING)
        simulation = self._simulation
        instance, signals = simulation.ready(), None
        if self._inputs:
            # FMPy asks for inputs at the beginning of a step of a co-simulation, which holds them.
            # Its solver does not ask for them within its steps, but sets the time.
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
            return None
        return result if result["time"][-1] >= end - interval / 2 else None

    def remarks(self, theta: Array, noise: float, *inputs: Array) -> list[str]:
        """A sentence if half the step would move parameters by much of their standard errors."""
        return time_step_remarks(self, ORDER, theta, noise, *inputs)

    @cached_property
    def _simulation(self) -> _Simulation:
        return _Simulation(self.path, self._description, self.interface or self._interfaces[0])


class _Simulation:
    """An unzipped FMU and its instance; the folder goes with the last reference to it."""

    def __init__(self, path: str, description: Any, interface: str) -> None:
        self.folder: str = tempfile.mkdtemp(prefix="miho-")
        weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)
        self.interface, self._path, self._description = interface, path, description
        self._instance: Any = None
        _fmpy().extract(path, self.folder)

    def ready(self) -> Any:
        """The instance as it was first, or a new one where there is none that can be reset."""
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
        """Let the instance have the inputs u (q, N) over t (N,) wherever its time is set."""
        instance = self._instance
        setter = getattr(instance, f"set{variables[0].type}")
        references = [variable.valueReference for variable in variables]

        def set_time(time: float) -> None:
            type(instance).setTime(instance, time)
            setter(references, [float(np.interp(time, t, row)) for row in u])

        instance.setTime = set_time

    def failed(self, error: Exception) -> None:
        """Give an instance up of which no function may be called any more."""
        if getattr(error, "status", None) == FATAL:
            self._instance = None

    def _reset(self) -> bool:
        try:
            self._instance.reset()
        except Exception:  # noqa: BLE001 -- it has no such function, or fails in it
            with contextlib.suppress(Exception):
                self._instance.freeInstance()
            return False
        return True


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Drop what is printed, by C as well, and raise what a solver's callbacks raised unheard."""
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
            f"an FMU needs a library that is missing ({error.name}); pip install 'miho[fmu]'"
        ) from None
    return fmpy


def _by_name(names: Names) -> dict[str, str]:
    return dict(names) if isinstance(names, Mapping) else {name: name for name in names}


def _is_set_before(variable: Any) -> bool:
    """Whether a variable may be set before a simulation (FMI 2.0.4, Sec. 2.2.7)."""
    starts = variable.start is not None or variable.initial == "exact"
    return bool(starts and variable.variability != "constant" and variable.causality != "input")


def _spelled(unit: str | None) -> str:
    """A unit of an FMU, such as N.m or m/s2, as it is spelled here."""
    text = re.sub(r"(?<=[A-Za-z])(-?[0-9]+)", r"^\1", unit or "").replace(".", "*")
    return {"N*m": "Nm", "1": NO_UNIT}.get(text, text)
