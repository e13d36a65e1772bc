"""Which ten tests should come next, to know the Michaelis constant better?

Twelve rates of an enzyme were measured at low concentrations only. `optimal_design` chooses ten of
the concentrations up to 10 mmol/l that narrow the interval of Km most, and predicts the
interval. The data are simulated (seed 16), with noise of 0.02 µmol/s.
"""

import matplotlib.pyplot as plt
import numpy as np

import miho
from miho.identification import optimal_design


def rate(S: "mmol/l", Vmax: "µmol/s", Km: "mmol/l") -> "µmol/s":
    return Vmax * S / (Km + S)


rng = np.random.default_rng(16)
S = np.linspace(0.1, 1.0, 12)
v = rate(S, 1.2, 0.7) + rng.normal(0, 0.02, S.size)
fit = miho.fit(rate, {"S": S, "v": v}, "v", {"Vmax": (0.1, 10), "Km": (0.01, 50)})

levels = {"S": np.linspace(0.1, 10, 100)}
design = optimal_design(fit.report(), levels, 10, goal="Km", repeats=10)
print(design)

chosen = design.chosen["S"].value_counts()
grid = np.linspace(0, 10, 200)
curve = fit.predict(grid)
figure, ax = plt.subplots()
ax.fill_between(grid, curve.low, curve.high, color="C1", alpha=0.3, linewidth=0)
ax.plot(grid, curve.value, color="C1", label="fit, with 95 % interval")
ax.plot(S, v, "o", color="C0", markersize=4, label="measured so far (simulated)")
at = np.array(chosen.index)
ax.plot(at, fit.predict(at).value, "D", color="C2", markersize=9, label="tests to do next")
for level, times in chosen.items():
    point = (level, fit.predict([level]).value[0])
    ax.annotate(f"{times} times", point, (6, -18), textcoords="offset points")
ax.set(xlabel="concentration [mmol/l]", ylabel="rate [µmol/s]", xlim=(0, 11.3), ylim=(0, None))
ax.legend(loc="lower right")
figure.savefig("next_test.png")
