"""At which speed does an engine give its largest torque, and how large is it?

A test bench gives the torque at full throttle. A cubic of the engine speed describes it, and
`fit.predict` gives the curve with the ends of its interval. The 60 readings are simulated (seed 1),
with noise of 4 Nm.
"""

import matplotlib.pyplot as plt
import numpy as np

import miho
from miho.vehicle.models import TorqueCubic

RPM = np.pi / 30  # rad/s
rng = np.random.default_rng(1)
omega = np.linspace(1500, 6500, 60) * RPM
model = TorqueCubic(omega_max=7000 * RPM)
torque = model.predict(np.array([[60.0, 1150.0, -880.0, -80.0]]), omega)[0]
torque = torque + rng.normal(0, 4, omega.size)

bounds = dict.fromkeys(["p0", "p1", "p2", "p3"], (-5000, 5000))  # Nm
fit = miho.fit(model, {"omega": omega, "T": torque}, "T", bounds)
print(fit)

speeds = np.linspace(1500, 6500, 501)
curve = fit.predict(speeds * RPM)
top = curve.value.argmax()
half = (curve.high - curve.low)[top] / 2
print(f"largest torque: {curve.value[top]:.1f} ± {half:.1f} Nm at {speeds[top]:.0f} rpm")

figure, ax = plt.subplots()
ax.plot(omega / RPM, torque, ".", color="C0", label="test bench (simulated)")
ax.fill_between(speeds, curve.low, curve.high, color="C1", alpha=0.3, linewidth=0)
ax.plot(speeds, curve.value, color="C1", label="cubic, with 95 % interval")
ax.plot(speeds[top], curve.value[top], "o", color="C2", markersize=9, label="largest torque")
ax.set(xlabel="engine speed [rpm]", ylabel="torque [Nm]")
ax.legend()
figure.savefig("engine_torque.png")
