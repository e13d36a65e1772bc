"""What are the resistances and time constants of a battery cell after a current pulse?

The equivalent circuit is a resistance in series with two RC elements, one fast and one slow. The
cell is discharged with 10 A for 60 s and then rests. The voltage is simulated (seed 2), with noise
of 3 mV. `constraints="tau1 < tau2"` keeps the two elements from changing places.
"""

import numpy as np

import miho

CURRENT, PULSE = 10.0, 60.0  # A, s


def voltage(t: "s", U: "V", R0: "Ohm", R1: "Ohm", tau1: "s", R2: "Ohm", tau2: "s") -> "V":
    def element(R, tau):
        rise = 1 - np.exp(-np.minimum(t, PULSE) / tau)
        return R * rise * np.exp(-np.maximum(t - PULSE, 0) / tau)

    on = np.where(t < PULSE, R0, 0)
    return U - CURRENT * (on + element(R1, tau1) + element(R2, tau2))


rng = np.random.default_rng(2)
t = np.arange(0, 300, 1.5)
U = voltage(t, 3.7, 0.015, 0.008, 4.0, 0.012, 45.0) + rng.normal(0, 0.003, t.size)

bounds = {
    "U": (2.5, 4.2),
    "R0": (0, 0.1),
    "R1": (0, 0.1),
    "R2": (0, 0.1),
    "tau1": {"low": 0.1, "high": 500, "scale": "log"},
    "tau2": {"low": 0.1, "high": 500, "scale": "log"},
}
fit = miho.fit(voltage, {"t": t, "U": U}, "U", bounds, constraints="tau1 < tau2")
print(fit)

fit.plot().savefig("battery_pulse.png", dpi=132)
