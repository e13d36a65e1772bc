"""How fast does a car notice that its front grip has fallen, and how sure is it?

A tracker starts from the report of an offline fit and takes one row after another at 50 Hz. After
30 s the grip D falls by 31 % within 0.2 s. The tracker raises an alarm in words. It also keeps the
rows that inform the parameters most; a fit of these rows gives the next offline report. The data
are simulated (seed 0). [Online](../online.md) explains the method.
"""

import matplotlib.pyplot as plt
import numpy as np

import miho


def tire(slip, *, B, C, D):
    return -D * np.sin(C * np.arctan(B * slip))


rng = np.random.default_rng(0)
bounds = {"B": (4, 36), "C": (1, 2.4), "D": (200, 8000)}
test = np.linspace(-0.16, 0.16, 300)
force = tire(test, B=12, C=1.6, D=4000) + rng.normal(0, 120, test.size)
offline = miho.fit(tire, {"slip": test, "force": force}, "force", bounds).report()

time = np.arange(0, 60, 0.02)
slip = 0.1 * np.sin(0.9 * time) + 0.03 * np.sin(2.3 * time)
grip = np.interp(time, (30, 30.2), (4000, 2760))
force = tire(slip, B=12, C=1.6, D=grip) + rng.normal(0, 120, time.size)

tracker = miho.Tracker(offline, changes={"D": 0.35}, input_noise={"slip": 0.0005})
estimate = []
for t, a, f in zip(time, slip + rng.normal(0, 0.0005, time.size), force, strict=True):
    state = tracker.update({"time": t, "slip": a, "force": f})
    estimate.append([state.values["D"], *state.intervals()[2]])
    if state.alarm:
        alarm = state.alarm
        print(alarm)
rows = tracker.dataset()
again = miho.fit(tire, dict(rows.columns), rows.output, bounds)
print(f"refit of {len(rows)} informative rows: D = {again.values['D']:.0f} N")

figure, ax = plt.subplots()
value, low, high = np.array(estimate).T / 1e3
ax.fill_between(time, low, high, color="C1", alpha=0.3, linewidth=0)
ax.plot(time, value, color="C1", label="tracked, with 95 % interval")
ax.plot(time, grip / 1e3, "--", color="black", linewidth=1.5, label="truth (simulated)")
ax.axvline(alarm.time, color="C3", label=f"alarm at {alarm.time:.2f} s")
ax.set(xlabel="time [s]", ylabel="grip D [kN]", xlim=(27, 35), ylim=(2, 5))
ax.legend()
figure.savefig("online.png")
