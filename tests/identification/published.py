"""Regression problems with published answers."""

from types import MappingProxyType

import numpy as np

from miho.data import Dataset
from miho.identification import CurveFit
from miho.identification.residuals import Loss, Square
from miho.models.model import Array, DifferencedModel, Model
from miho.optim import Parameter, Space


class Misra1a(DifferencedModel):
    """y = b1 (1 - exp(-b2 x))."""

    inputs = MappingProxyType({"x": "-"})
    parameters = MappingProxyType({"b1": "-", "b2": "-"})
    output = "-"

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        b1, b2 = thetas.T[:, :, None]
        return np.asarray(b1 * -np.expm1(-b2 * inputs[0]))


class MGH09(DifferencedModel):
    """y = b1 (x^2 + b2 x) / (x^2 + b3 x + b4)."""

    inputs = MappingProxyType({"x": "-"})
    parameters = MappingProxyType({"b1": "-", "b2": "-", "b3": "-", "b4": "-"})
    output = "-"

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        b1, b2, b3, b4 = thetas.T[:, :, None]
        x = inputs[0]
        return np.asarray(b1 * (x**2 + b2 * x) / (x**2 + b3 * x + b4))


class MichaelisMenten(DifferencedModel):
    """rate = Vm conc / (K + conc)."""

    inputs = MappingProxyType({"x": "-"})
    parameters = MappingProxyType({"Vm": "-", "K": "-"})
    output = "-"

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        Vm, K = thetas.T[:, :, None]
        return np.asarray(Vm * inputs[0] / (K + inputs[0]))


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


class Plane(Model):
    """y = b0 + b1 x1 + ... + b6 x6, linear in all."""

    inputs = MappingProxyType({f"x{k}": "-" for k in range(1, 7)})
    parameters = MappingProxyType({f"b{k}": "-" for k in range(7)})
    output = "-"
    linear = tuple(parameters)

    def predict(self, thetas: Array, *inputs: Array) -> Array:
        return np.asarray(thetas[:, :1] + thetas[:, 1:] @ np.stack(inputs))

    def jacobian(self, theta: Array, *inputs: Array) -> Array:
        return np.stack([np.ones_like(inputs[0]), *inputs], axis=1)


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


def mgh09() -> CurveFit:
    """NIST StRD, MGH09 (Kowalik and Osborne 1978), in a box from zero to NIST's far start."""
    y = [0.1957, 0.1947, 0.1735, 0.1600, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246]
    x = [4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625]
    return problem(MGH09(), np.array(x), np.array(y), [(0, 42)] * 4)


def puromycin() -> CurveFit:
    """Bates and Watts 1988, table A1.3, treated cells."""
    x = np.repeat([0.02, 0.06, 0.11, 0.22, 0.56, 1.10], 2)
    y = np.array([76, 47, 97, 107, 123, 139, 159, 152, 191, 201, 207, 200], dtype=float)
    return problem(MichaelisMenten(), x, y, [(10, 1000), (1e-3, 10)])


def line(
    y: Array, x: Array, rho: Loss | None = None, b: tuple[float, float] = (-100, 100)
) -> CurveFit:
    return problem(Line(), x, y, [(-100, 100), b], rho)


LONGLEY = """
83.0 234289 2356 1590 107608 1947 60323
88.5 259426 2325 1456 108632 1948 61122
88.2 258054 3682 1616 109773 1949 60171
89.5 284599 3351 1650 110929 1950 61187
96.2 328975 2099 3099 112075 1951 63221
98.1 346999 1932 3594 113270 1952 63639
99.0 365385 1870 3547 115094 1953 64989
100.0 363112 3578 3350 116219 1954 63761
101.2 397469 2904 3048 117388 1955 66019
104.6 419180 2822 2857 118734 1956 67857
108.4 442769 2936 2798 120445 1957 68169
110.8 444546 4681 2637 121950 1958 66513
112.6 482704 3813 2552 123366 1959 68655
114.2 502601 3931 2514 125368 1960 69564
115.7 518173 4806 2572 127852 1961 69331
116.9 554894 4007 2827 130081 1962 70551
"""


def longley() -> CurveFit:
    """NIST StRD, Longley (Longley 1967): employment over six columns that rise together."""
    *x, y = np.loadtxt(LONGLEY.splitlines()).T
    columns = dict(zip(Plane.inputs, x, strict=True)) | {"y": y}
    space = Space(tuple(Parameter(name, "-", -1e7, 1e7) for name in Plane.parameters))
    return CurveFit(Plane(), Dataset("longley", columns, dict.fromkeys(columns, "-"), "y"), space)
