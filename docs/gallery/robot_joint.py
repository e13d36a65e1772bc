"""How much of a robot joint's torque is inertia, gravity and friction?

The torque of one joint depends on three columns: angle, speed and acceleration. Friction follows
Stribeck: it falls from a breakaway torque to Coulomb friction and then rises with the speed. The
motion is 20 s of two sines, simulated (seed 4) with torque noise of 0.3 Nm. A formula may use
`np.sign` and `np.abs`.
"""

import matplotlib.pyplot as plt
import numpy as np

import miho


def friction(v, Fc, Fs, vs, b):
    return np.sign(v) * (Fc + (Fs - Fc) * np.exp(-np.abs(v) / vs)) + b * v


def torque(q, v, a, inertia, gravity, Fc, Fs, vs, b):
    return inertia * a + gravity * np.cos(q) + friction(v, Fc, Fs, vs, b)


rng = np.random.default_rng(4)
t = np.linspace(0, 20, 1000)
w = 2 * np.pi * np.array([0.1, 0.45])  # rad/s
q = np.sin(w[0] * t) + 0.25 * np.sin(w[1] * t)  # rad
v = w[0] * np.cos(w[0] * t) + 0.25 * w[1] * np.cos(w[1] * t)
a = -(w[0] ** 2) * np.sin(w[0] * t) - 0.25 * w[1] ** 2 * np.sin(w[1] * t)
tau = torque(q, v, a, 1.8, 9.0, 3.0, 5.5, 0.08, 2.5) + rng.normal(0, 0.3, t.size)

bounds = {"inertia": (0, 10), "gravity": (0, 50), "Fc": (0, 20), "Fs": (0, 20), "b": (0, 20)}
bounds["vs"] = {"low": 0.005, "high": 1, "scale": "log"}
fit = miho.fit(torque, (q, v, a), tau, bounds)
print(fit)

values = fit.values
rest = values["inertia"] * a + values["gravity"] * np.cos(q)
speed = np.linspace(-1.4, 1.4, 701)
figure, ax = plt.subplots()
ax.plot(v, tau - rest, ".", markersize=3, label="torque without inertia and gravity (simulated)")
names = ("Fc", "Fs", "vs", "b")
ax.plot(speed, friction(speed, *(values[name] for name in names)), label="identified friction")
ax.set(xlabel="joint speed [rad/s]", ylabel="friction torque [Nm]", ylim=(-8.5, 10.5))
ax.legend(loc="upper left", markerscale=3)
figure.savefig("robot_joint.png")
