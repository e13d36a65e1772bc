"""Which Magic Formula describes the lateral force of a tire over its slip angle?

The model has five parameters: the shape B and C, the peak D and two offsets. The bounds are wide,
and no starting point is needed. The 400 samples are simulated (seed 0), with noise of 150 N.
[How far to trust it](../trust.md) explains the intervals.
"""

import numpy as np

import miho
from miho.vehicle.models import Pacejka

rng = np.random.default_rng(0)
alpha = rng.uniform(-0.2, 0.2, 400)  # slip angle [rad]
truth = np.array([[14.0, 1.6, 4200.0, 0.004, 120.0]])  # B, C, D, Sx, Sy
force = Pacejka().predict(truth, alpha)[0] + rng.normal(0, 150, 400)

bounds = {
    "B": (2, 40),  # 1/rad
    "C": (1, 2.5),
    "D": (1000, 9000),  # N
    "Sx": (-0.05, 0.05),  # rad
    "Sy": (-900, 900),  # N
}
fit = miho.fit(Pacejka(), {"alpha": alpha, "Fy": force}, "Fy", bounds)
print(fit)

fit.plot().savefig("tire.png", dpi=132)
