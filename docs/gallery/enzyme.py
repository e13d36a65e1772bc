"""What are the largest rate and the Michaelis constant of an enzyme?

The rate follows Michaelis and Menten. Each of eight concentrations is measured three times. The
data are simulated (seed 3), with noise of 0.02 µmol/s. Rows are few, so the report's
profile intervals, which need not be symmetric, are better than the standard errors.
"""

import numpy as np

import miho


def rate(S: "mmol/l", Vmax: "µmol/s", Km: "mmol/l") -> "µmol/s":
    return Vmax * S / (Km + S)


rng = np.random.default_rng(3)
S = np.repeat([0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4], 3)
v = rate(S, 1.2, 0.7) + rng.normal(0, 0.02, S.size)

bounds = {"Vmax": (0, 10), "Km": {"low": 0.001, "high": 100, "scale": "log"}}
fit = miho.fit(rate, {"S": S, "v": v}, "v", bounds)
print(fit)
columns = ["parameter", "value", "unit", "profile low", "profile high"]
print(fit.report().parameters[columns].to_string(index=False))

fit.plot().savefig("enzyme.png", dpi=132)
