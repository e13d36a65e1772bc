"""At which dose does a drug have half of its effect?

The Hill curve has a lower and an upper plateau, a slope and the dose EC50. Doses cover five
decades, so EC50 is searched on a logarithmic scale. Four wells for each of ten doses are simulated
(seed 20), with noise of 5 %.
"""

import matplotlib.pyplot as plt
import numpy as np

import miho


def response(dose: "nmol/l", bottom: "%", top: "%", EC50: "nmol/l", n) -> "%":
    return bottom + (top - bottom) / (1 + (EC50 / dose) ** n)


rng = np.random.default_rng(20)
dose = np.repeat(np.logspace(-1, 4, 10), 4)
effect = response(dose, 4.0, 96.0, 35.0, 1.1) + rng.normal(0, 5, dose.size)

bounds = {
    "bottom": (-20, 50),
    "top": (50, 150),
    "EC50": {"low": 0.01, "high": 1e5, "scale": "log"},
    "n": (0.2, 5),
}
fit = miho.fit(response, {"dose": dose, "effect": effect}, "effect", bounds)
print(fit)

doses = np.logspace(-1, 4, 200)
curve = fit.predict(doses)
EC50 = fit.parameters.loc["EC50"]
figure, ax = plt.subplots()
ax.axvspan(EC50["low"], EC50["high"], color="C2", alpha=0.3, linewidth=0, label="EC50, 95 %")
ax.semilogx(dose, effect, "o", markersize=4, alpha=0.7, label="wells (simulated)")
ax.fill_between(doses, curve.low, curve.high, color="C1", alpha=0.3, linewidth=0)
ax.plot(doses, curve.value, color="C1", label="Hill curve, with 95 % interval")
ax.set(xlabel="dose [nmol/l]", ylabel="effect [%]")
ax.legend()
figure.savefig("dose_response.png")
