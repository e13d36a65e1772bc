"""How fast does a drug leave the blood after an infusion of one hour?

Two compartments, blood and tissue, exchange the drug; the model is the differential equation
itself ([Trajectories](../trajectories.md)). Errors are proportional to the concentration, which
`sigma` states up to a factor. Fifteen samples are simulated (seed 9).
"""

import matplotlib.pyplot as plt
import numpy as np

import miho
from miho.models import Trajectory


def exchange(A1: "mg", A2: "mg", rate: "mg/h", *, CL: "l/h", V1: "l", Q: "l/h", V2: "l"):
    flow = Q * (A1 / V1 - A2 / V2)
    return rate - CL * A1 / V1 - flow, flow


def concentration(A1: "mg", *, V1: "l") -> "mg/l":
    return A1 / V1


# The infusion is constant between rows.
states = {"A1": 0.0, "A2": 0.0}
model = Trajectory(exchange, states, [concentration], interpolation="hold", substeps=8)
rng = np.random.default_rng(9)
t = np.array([0, 0.25, 0.5, 0.75, 1, 1.25, 1.5, 2, 3, 4, 6, 8, 12, 18, 24])  # h
rate = np.where(t < 1, 100.0, 0.0)
c = model.predict(np.array([[4.0, 10.0, 8.0, 30.0]]), t, rate)[0]
c = c * (1 + 0.08 * rng.standard_normal(t.size))

bounds = {"CL": (0.1, 50), "V1": (1, 100), "Q": (0.1, 50), "V2": (1, 200)}
sigma = np.maximum(0.08 * c, 0.05)
columns = {"t": t, "rate": rate, "c": c}
fit = miho.fit(model, columns, "c", bounds, sigma=sigma, sigma_known=False)
print(fit)

fine = np.linspace(0, 24, 481)
curve = fit.predict((fine, np.where(fine < 1, 100.0, 0.0)))
figure, ax = plt.subplots()
ax.semilogy(t[1:], c[1:], "o", label="samples (simulated)")
ax.fill_between(fine[1:], curve.low[1:], curve.high[1:], color="C1", alpha=0.3, linewidth=0)
ax.plot(fine[1:], curve.value[1:], color="C1", label="two compartments, with 95 % interval")
ax.set(xlabel="time since the start of the infusion [h]", ylabel="concentration [mg/l]")
ticks = [0.2, 0.5, 1, 2, 5]
ax.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
ax.minorticks_off()
ax.legend()
figure.savefig("pharmacokinetics.png")
