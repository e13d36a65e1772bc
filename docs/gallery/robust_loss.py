"""What if some readings of a sensor are plainly wrong?

Ten of 60 readings of a thermistor are 40 % too low. Least squares follows them. The Cauchy loss
limits the weight of a large residual; its scale comes from the known noise `sigma`. The data are
simulated (seed 15), with noise of 0.1 kOhm.
"""

import matplotlib.pyplot as plt
import numpy as np

import miho


def resistance(T: "°C", R25: "kOhm", B: "K") -> "kOhm":
    return R25 * np.exp(B * (1 / (T + 273.15) - 1 / 298.15))


rng = np.random.default_rng(15)
T = np.linspace(0, 60, 60)
R = resistance(T, 10.0, 3950.0) + rng.normal(0, 0.1, T.size)
R[rng.choice(30, 10, replace=False)] *= 0.6

bounds = {"R25": (1, 50), "B": (1000, 8000)}
square = miho.fit(resistance, T, R, bounds, sigma=0.1)
robust = miho.fit(resistance, T, R, bounds, sigma=0.1, loss="cauchy")
print(robust)
for label, fit in (("truth", None), ("least squares", square), ("Cauchy", robust)):
    values = fit.values if fit else {"R25": 10.0, "B": 3950.0}
    print(f"{label:>13}: R25 = {values['R25']:.2f} kOhm, B = {values['B']:.0f} K")

figure, ax = plt.subplots()
ax.plot(T, R, "o", color="0.5", markersize=4, label="readings (simulated)")
ax.plot(T, square.predict(T).value, color="C0", label="least squares")
ax.plot(T, robust.predict(T).value, color="C1", label="Cauchy loss")
ax.plot(T, resistance(T, 10.0, 3950.0), "--", color="black", linewidth=1.5, label="truth")
ax.set(xlabel="temperature [°C]", ylabel="resistance [kOhm]")
ax.legend()
figure.savefig("robust_loss.png")
