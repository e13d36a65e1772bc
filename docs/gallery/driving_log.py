"""Which tire curve does a driving log reveal, without any test rig?

A car weaves at 30 to 45 m/s. Its log holds noisy speeds, yaw rate, steering angle and acceleration
at 50 Hz, from which the slip angle and the lateral force of the front axle follow. Errors of
neighbouring rows are correlated, and the intervals allow for it. The log is simulated (seed 0), so
the true curve is known.
[Your own data](../own-data.md#driving-logs) shows how to read a log from a file.
"""

import matplotlib.pyplot as plt
import numpy as np

import miho
from miho.vehicle.data import simulated_axle_drive
from miho.vehicle.data.synthetic_handling import AXLES
from miho.vehicle.models import Pacejka

car = {"mass": 800.0, "lf": 1.7, "lr": 1.271, "Izz": 850.0}  # kg, m, m, kg m^2
data = simulated_axle_drive(car, "front", seed=0)
bounds = {"B": (2, 40), "C": (1, 2.5), "D": (1000, 9000), "Sx": (-0.05, 0.05), "Sy": (-900, 900)}
fit = miho.fit(Pacejka(), dict(data.columns), data.output, bounds)
print(fit)

alpha = data["alpha"]
slip = np.linspace(alpha.min(), alpha.max(), 200)
curve = fit.predict(slip)
truth = Pacejka().predict(np.array([list(AXLES["front"].values())]), slip)[0]
figure, ax = plt.subplots()
degrees = np.degrees(slip)
ax.plot(np.degrees(alpha), data[data.output] / 1e3, ".", markersize=3, label="log (simulated)")
ax.fill_between(degrees, curve.low / 1e3, curve.high / 1e3, color="C1", alpha=0.3, linewidth=0)
ax.plot(degrees, curve.value / 1e3, color="C1", label="identified, with 95 % interval")
ax.plot(degrees, truth / 1e3, "--", color="black", linewidth=1.5, label="truth")
ax.set(xlabel="slip angle of the front axle [°]", ylabel="lateral force [kN]")
ax.legend(markerscale=3)
figure.savefig("driving_log.png")
