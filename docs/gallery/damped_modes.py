"""Which two damped vibrations make up a measured decay?

Each mode has an amplitude, a decay rate, a frequency and a phase. A sum of sines has many local
minima. The search therefore compares the ends of many descents; it needs bounds and no start. The
400 samples are simulated (seed 5), with noise of 0.1 m/s².
"""

import numpy as np

import miho


def mode(t, a, d, f, p):
    return a * np.exp(-d * t) * np.sin(2 * np.pi * f * t + p)


def acceleration(
    t: "s",
    a1: "m/s^2", d1: "1/s", f1: "Hz", p1: "rad",
    a2: "m/s^2", d2: "1/s", f2: "Hz", p2: "rad",
) -> "m/s^2":  # fmt: skip
    return mode(t, a1, d1, f1, p1) + mode(t, a2, d2, f2, p2)


rng = np.random.default_rng(5)
t = np.linspace(0, 4, 400)
y = acceleration(t, 1.0, 0.5, 3.2, 0.3, 0.8, 0.9, 4.1, -1.2) + rng.normal(0, 0.1, t.size)

bounds = {}
for k in "12":
    bounds |= {f"a{k}": (0, 5), f"d{k}": (0, 5), f"f{k}": (0.5, 10), f"p{k}": (-4, 4)}
fit = miho.fit(acceleration, {"t": t, "y": y}, "y", bounds, constraints="f1 < f2")
print(fit)

fit.plot().savefig("damped_modes.png", dpi=132)
