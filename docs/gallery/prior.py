"""How hot will a motor winding become, if the test ended too early to see?

After 12 minutes the temperature still rises, so the data determine the final rise badly. The data
sheet says 60 K ± 4 K, which enters as a prior. The report states how much of the
information comes from it. The readings are simulated (seed 14), with a known noise of 0.5 K.
"""

import matplotlib.pyplot as plt
import numpy as np

import miho


def rise(t: "min", final: "K", tau: "min") -> "K":
    return final * (1 - np.exp(-t / tau))


rng = np.random.default_rng(14)
t = np.linspace(0, 12, 25)
T = rise(t, 62.0, 20.0) + rng.normal(0, 0.5, t.size)

bounds = {"final": (5, 300), "tau": (1, 200)}
without = miho.fit(rise, t, T, bounds, sigma=0.5)
bounds["final"] = {"low": 5, "high": 300, "prior": (60, 4)}
fit = miho.fit(rise, t, T, bounds, sigma=0.5)
print(fit)
print(fit.report().priors.T.to_string(header=False))

later = np.linspace(0, 60, 121)
figure, ax = plt.subplots()
for k, (label, result) in enumerate((("data alone", without), ("data and prior", fit))):
    curve = result.predict(later)
    ax.fill_between(later, curve.low, curve.high, color=f"C{k}", alpha=0.3, linewidth=0)
    ax.plot(later, curve.value, color=f"C{k}", label=f"{label}, with 95 % interval")
ax.plot(later, rise(later, 62.0, 20.0), "--", color="black", linewidth=1.5, label="truth")
ax.plot(t, T, ".", color="0.3", label="readings (simulated)")
ax.set(xlabel="time [min]", ylabel="temperature rise [K]", ylim=(0, 90))
ax.legend()
figure.savefig("prior.png")
