"""Which rolling resistance and drag slow down a car that coasts?

The model is a simulation: a function in which SciPy solves the differential equation. It is called
as it is, and derivatives are finite differences. A simulation that a tool exported as a file works
in the same way ([FMU](fmu.md)). The coast from 35 m/s is simulated (seed 10), with noise of
0.1 m/s.
"""

import numpy as np
from scipy.integrate import solve_ivp

import miho

MASS, RHO = 1400.0, 1.2  # kg, kg/m^3


def coast(t: "s", *, v0: "m/s", rolling: "N", CdA: "m^2") -> "m/s":
    def acceleration(_, v):
        return [-(rolling + RHO / 2 * CdA * v[0] ** 2) / MASS]

    return solve_ivp(acceleration, (0, t[-1]), [v0], t_eval=t, rtol=1e-8).y[0]


rng = np.random.default_rng(10)
t = np.linspace(0, 80, 161)
v = coast(t, v0=35.0, rolling=180.0, CdA=0.65) + rng.normal(0, 0.1, t.size)

bounds = {"v0": (20, 50), "rolling": (0, 1000), "CdA": (0.1, 2)}
fit = miho.fit(coast, {"t": t, "v": v}, "v", bounds)
print(fit)

fit.plot().savefig("simulation.png", dpi=132)
