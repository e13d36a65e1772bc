"""How large will a growing culture become, if it was measured only for the first half?

The data end soon after the point of inflection. The interval of the curve shows how much they say
about the plateau. The doubling time is a further quantity, `tied` to the rate, and has an
error. Optical densities are simulated (seed 8), with noise of 0.02.
"""

import matplotlib.pyplot as plt
import numpy as np

import miho


def growth(t: "h", K, r: "1/h", t0: "h"):
    return K / (1 + np.exp(-r * (t - t0)))


rng = np.random.default_rng(8)
t = np.linspace(0, 7, 29)
density = growth(t, 1.6, 0.9, 6.0) + rng.normal(0, 0.02, t.size)

bounds = {"K": (0.1, 10), "r": (0.05, 5), "t0": (0, 30), "doubling": {"unit": "h"}}
fit = miho.fit(growth, t, density, bounds, tied={"doubling": "log(2) / r"})
print(fit)

later = np.linspace(0, 14, 141)
curve = fit.predict(later)
figure, ax = plt.subplots()
ax.plot(t, density, "o", markersize=4, label="measured (simulated)")
ax.plot(later, growth(later, 1.6, 0.9, 6.0), "--", color="0.4", label="truth")
ax.fill_between(later, curve.low, curve.high, color="C1", alpha=0.3, linewidth=0)
ax.plot(later, curve.value, color="C1", label="fit and forecast, with 95 % interval")
ax.axvline(t[-1], color="0.6", linewidth=1)
ax.set(xlabel="time [h]", ylabel="optical density [-]", ylim=(-0.05, None))
ax.legend(loc="upper left")
figure.savefig("logistic_growth.png")
