"""Regression problems with published answers."""

from types import MappingProxyType

import numpy as np

from miho.data import Dataset
from miho.identification import CurveFit
from miho.identification.loss import Loss, Square
from miho.models.model import Array, Model, central_differences
from miho.optim import Parameter, Space


class Misra1a(Model):
    """y = b1 (1 - exp(-b2 x))."""

    inputs = MappingProxyType({"x": "-"})
    parameters = MappingProxyType({"b1": "-", "b2": "-"})
    output = "-"

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        b1, b2 = thetas.T[:, :, None]
        return np.asarray(b1 * -np.expm1(-b2 * inputs[0]))

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        return central_differences(self, theta, *inputs)


class MichaelisMenten(Model):
    """rate = Vm conc / (K + conc)."""

    inputs = MappingProxyType({"x": "-"})
    parameters = MappingProxyType({"Vm": "-", "K": "-"})
    output = "-"

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        Vm, K = thetas.T[:, :, None]
        return np.asarray(Vm * inputs[0] / (K + inputs[0]))

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        return central_differences(self, theta, *inputs)


class Line(Model):
    """y = a + b x, linear in both."""

    inputs = MappingProxyType({"x": "-"})
    parameters = MappingProxyType({"a": "-", "b": "-"})
    output = "-"
    linear = ("a", "b")

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        a, b = thetas.T[:, :, None]
        return np.asarray(a + b * inputs[0])

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        return np.stack([np.ones_like(inputs[0]), inputs[0]], axis=1)


def problem(
    model: Model, x: Array, y: Array, bounds: list[tuple[float, float]], rho: Loss | None = None
) -> CurveFit:
    space = Space(
        tuple(Parameter(n, "-", *b) for n, b in zip(model.parameters, bounds, strict=True))
    )
    data = Dataset("published", {"x": x, "y": y}, {"x": "-", "y": "-"}, "y")
    return CurveFit(model, data, space, rho or Square())


def misra1a() -> CurveFit:
    """NIST StRD, Misra1a (Misra 1978): fourteen rows of monomolecular adsorption."""
    y = [10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40,
         75.47, 81.78]  # fmt: skip
    x = [77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1,
         689.1, 760.0]  # fmt: skip
    return problem(Misra1a(), np.array(x), np.array(y), [(10, 1000), (1e-5, 1e-2)])


def puromycin() -> CurveFit:
    """Bates and Watts 1988, table A1.3, treated cells."""
    x = np.repeat([0.02, 0.06, 0.11, 0.22, 0.56, 1.10], 2)
    y = np.array([76, 47, 97, 107, 123, 139, 159, 152, 191, 201, 207, 200], dtype=float)
    return problem(MichaelisMenten(), x, y, [(10, 1000), (1e-3, 10)])


def line(
    y: Array, x: Array, rho: Loss | None = None, b: tuple[float, float] = (-100, 100)
) -> CurveFit:
    return problem(Line(), x, y, [(-100, 100), b], rho)
