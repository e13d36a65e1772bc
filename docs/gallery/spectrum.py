"""Which peaks make up a spectrum on a sloping background?

Two peaks are Gaussian, the third is Lorentzian, and two of them overlap. Three separate intervals
for the centers keep the peaks in their order. The 300 channels are simulated (seed 6), with
noise of 1.5 counts per second.
"""

import matplotlib.pyplot as plt
import numpy as np

import miho


def gauss(x, A, x0, w):
    return A * np.exp(-4 * np.log(2) * ((x - x0) / w) ** 2)  # w: full width at half maximum


def lorentz(x, A, x0, w):
    return A / (1 + 4 * ((x - x0) / w) ** 2)


def spectrum(x, A1, x1, w1, A2, x2, w2, A3, x3, w3, c0, c1):
    peaks = gauss(x, A1, x1, w1) + gauss(x, A2, x2, w2) + lorentz(x, A3, x3, w3)
    return peaks + c0 + c1 * x


rng = np.random.default_rng(6)
x = np.linspace(10, 40, 300)
truth = (60, 18.0, 2.0, 35, 20.4, 2.4, 45, 31.0, 1.5, 20.0, -0.3)
y = spectrum(x, *truth) + rng.normal(0, 1.5, x.size)

bounds = {"c0": (-100, 100), "c1": (-5, 5), "x1": (15, 19), "x2": (19, 25), "x3": (25, 38)}
bounds |= {f"A{k}": (0, 200) for k in "123"} | {f"w{k}": (0.2, 8) for k in "123"}
fit = miho.fit(spectrum, x, y, bounds)
print(fit)

p = fit.values
figure, ax = plt.subplots()
ax.plot(x, y, ".", color="0.6", markersize=4, label="data (simulated)")
line = p["c0"] + p["c1"] * x
for k, (shape, name) in enumerate([(gauss, "Gauss"), (gauss, "Gauss"), (lorentz, "Lorentz")], 1):
    peak = shape(x, p[f"A{k}"], p[f"x{k}"], p[f"w{k}"])
    ax.fill_between(x, line, line + peak, alpha=0.4, color=f"C{k + 1}", label=f"{name} {k}")
ax.plot(x, fit.predict(x).value, color="C1", label="fit")
ax.set(xlabel="diffraction angle [°]", ylabel="intensity [counts/s]")
ax.legend()
figure.savefig("spectrum.png")
