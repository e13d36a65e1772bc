"""How many evaluations do different methods need for the same tire?

Four methods search within the same wide bounds with their default settings, each with five seeds
and at most 3,000 evaluations. `minimize` runs a method once and records each improvement; the
picture shows the median over seeds. MIHO-GN begins with a part of the rows, which counts as a part
of an evaluation; its curve begins where it first evaluates all of them. The 300 samples are
simulated (seed 18). The [arena](../results.md#the-arena) is the large comparison.
"""

import matplotlib.pyplot as plt
import numpy as np

import miho
from miho.methods import PSO, DifferentialEvolution, LeastSquares
from miho.vehicle.models import Pacejka

rng = np.random.default_rng(18)
alpha = rng.uniform(-0.2, 0.2, 300)
force = Pacejka().predict(np.array([[14.0, 1.6, 4200.0, 0.004, 120.0]]), alpha)[0]
force += rng.normal(0, 150, alpha.size)
columns, units = {"alpha": alpha, "Fy": force}, {"alpha": "rad", "Fy": "N"}
data = miho.Dataset("tire", columns, units, "Fy")
bounds = {"B": (1, 80), "C": (0.5, 3), "D": (100, 2e4), "Sx": (-0.1, 0.1), "Sy": (-3e3, 3e3)}
space = miho.Space(
    tuple(miho.Parameter(name, Pacejka.parameters[name], *ends) for name, ends in bounds.items())
)
problem = miho.CurveFit(Pacejka(), data, space)

methods = {
    "MIHO-GN": miho.MIHOGN(),
    "least squares, best of 500": LeastSquares(),
    "differential evolution": DifferentialEvolution(),
    "particle swarm": PSO(),
}
grid = np.logspace(0, np.log10(3000), 200)
figure, ax = plt.subplots()
for label, method in methods.items():
    curves = []
    for seed in range(5):
        record = miho.minimize(method, problem, miho.Budget(evaluations=3000), seed)
        errors = np.sqrt([np.nan, *record.trace.loss])
        curves.append(errors[np.searchsorted(record.trace.evaluations, grid, side="right")])
    median = np.median(curves, axis=0)
    ax.loglog(grid, median, label=label)
    print(f"{label}: median error {median[-1]:.1f} N")
ax.set(xlabel="evaluations", ylabel="error (root mean square) [N]")
ax.set_yticks([200, 500, 1000, 2000, 5000], ["200", "500", "1000", "2000", "5000"])
ax.minorticks_off()
ax.legend()
figure.savefig("compare_methods.png")
