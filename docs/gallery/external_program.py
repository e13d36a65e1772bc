"""How can an external program be fitted, for example a simulator without a Python interface?

The program reads `parameters.json` and `inputs.csv` in an empty folder and writes `output.txt`, a
number for each row. Here it steps the temperature of a cooling cup, in a new process for each
evaluation; any other program can take its place. The readings are simulated (seed 11), with noise
of 0.3 °C.
"""

import sys

import numpy as np

import miho
from miho.models.command import CommandModel

PROGRAM = """
import json
p = json.load(open("parameters.json"))
rows = [float(row) for row in open("inputs.csv").read().split()[1:]]
T, now, output = 85.0, 0.0, []
for t in rows:
    steps = 50
    for _ in range(steps):
        T += (t - now) / steps * (p["room"] - T) / p["tau"]
    now = t
    output.append(T)
open("output.txt", "w").write("\\n".join(map(str, output)))
"""
command = [sys.executable, "-I", "-S", "-c", PROGRAM]
model = CommandModel(command, {"t": "min"}, {"room": "°C", "tau": "min"}, "°C", seconds=10)

rng = np.random.default_rng(11)
t = np.linspace(1, 60, 60)
T = model.predict(np.array([[21.0, 18.0]]), t)[0] + rng.normal(0, 0.3, t.size)

fit = miho.fit(model, {"t": t, "T": T}, "T", {"room": (0, 40), "tau": (2, 100)})
print(fit)

fit.plot().savefig("external_program.png", dpi=132)
