"""How can a simulation be fitted that another tool has exported as an FMU?

FMPy runs the FMU: `pip install 'miho[fmu]'` ([settings](../trajectories.md#an-fmu-as-a-model)).
Modelica and Simulink tools export FMUs. Here, `swing.fmu` is a mass on a spring with a damper,
compiled from [C](swing/swing.c) with [its description](swing/modelDescription.xml); put your own
file in its place. The force is a column of the data. The swing is simulated (seed 12), with noise
of 5 mm.
"""

import matplotlib.pyplot as plt
import numpy as np

import miho
from miho.models import FmuModel

names = {"k": "k", "c": "c", "x_0": "start.x"}  # names of parameters here and in the FMU
model = FmuModel("swing.fmu", names, outputs=["x"], columns=["force"])

rng = np.random.default_rng(12)
t = np.linspace(0, 10, 101)
force = np.where(t < 4, 0.0, 3.0)
x = model.predict(np.array([[8.0, 0.9, 0.4]]), t, force)[0] + rng.normal(0, 0.005, t.size)

bounds = {"k": (1, 50), "c": (0, 5), "x_0": (-1, 1)}
fit = miho.fit(model, {"t": t, "force": force, "x": x}, "x", bounds)
print(fit)

figure, ax = plt.subplots()
ax.axvspan(4, 10, color="0.93", label="force of 3 N")
ax.plot(t, x, "o", color="0.5", markersize=4, label="measured (simulated)")
ax.plot(t, fit.predict({"t": t, "force": force}).value, label="fitted FMU")
ax.set(xlabel="t [s]", ylabel="x [m]", xlim=(0, 10))
ax.legend()
figure.savefig("fmu.png")
