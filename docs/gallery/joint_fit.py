"""What is the activation energy of a reaction that was followed at two temperatures?

Each run gives only its own rate. Together they give the activation energy E and the rate k at
300 K, which both runs share. The start concentration c0 is `local`: each run has a separate one.
Noise is estimated for each run. The data are simulated (seed 12).
"""

import matplotlib.pyplot as plt
import numpy as np

import miho

R = 8.314e-3  # kJ/(mol K)


def run_at(T):
    def concentration(t: "min", c0: "mol/l", k: "1/min", E: "kJ/mol") -> "mol/l":
        return c0 * np.exp(-k * np.exp(-E / R * (1 / T - 1 / 300)) * t)

    return concentration


rng = np.random.default_rng(12)
t = np.linspace(0, 60, 31)
runs = {"cold": (295, 1.0, 0.02), "warm": (315, 0.8, 0.01)}  # K, mol/l, noise in mol/l
parts = {}
for name, (T, c0, noise) in runs.items():
    c = run_at(T)(t, c0, 0.02, 65.0) + rng.normal(0, noise, t.size)
    parts[name] = miho.Part(run_at(T), {"t": t, "c": c}, "c")

bounds = {"c0": (0, 5), "k": {"low": 1e-4, "high": 1, "scale": "log"}, "E": (10, 200)}
fit = miho.fit_joint(parts, bounds, local=["c0"])
print(fit)

figure, ax = plt.subplots()
for k, (name, (T, *_)) in enumerate(runs.items()):
    curve = fit.part(name).predict(t)
    ax.plot(t, parts[name].x["c"], "o", color=f"C{k}", markersize=4, label=f"{T} K (simulated)")
    ax.fill_between(t, curve.low, curve.high, color=f"C{k}", alpha=0.3, linewidth=0)
    ax.plot(t, curve.value, color=f"C{k}", label=f"{T} K, joint fit with 95 % interval")
ax.set(xlabel="time [min]", ylabel="concentration [mol/l]")
ax.legend()
figure.savefig("joint_fit.png")
