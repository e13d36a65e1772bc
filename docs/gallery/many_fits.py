"""What is the lifetime in each pixel of a fluorescence image?

Each of 2,500 pixels has a decay of 60 points. `fit_many` fits them one by one, in C, and
returns a table with a row for each pixel. The image is simulated (seed 17): three
spots of a longer lifetime on a background of 1.5 ns.
"""

import matplotlib.pyplot as plt
import numpy as np

import miho

rng = np.random.default_rng(17)
rows, columns = np.mgrid[0:50, 0:50]
lifetime = np.full(rows.shape, 1.5)  # ns
for row, column, size in ((14, 12, 7), (33, 28, 9), (12, 38, 6)):
    distance = np.hypot(rows - row, columns - column)
    lifetime += 1.5 * np.exp(-((distance / size) ** 2))

t = np.linspace(0, 10, 60)  # ns
decays = 100 * np.exp(-t / lifetime.reshape(-1, 1))
decays += rng.normal(0, 3, decays.shape)


def decay(t, A, tau):
    return A * np.exp(-t / tau)


table = miho.fit_many(decay, t, decays, {"A": (1, 1000), "tau": (0.1, 20)})
print(table.describe().loc[["mean", "min", "max"]].round(3).to_string())
print("converged:", int(table["converged"].sum()), "of", len(table))
deviation = (table["tau"] - lifetime.ravel()) / table["tau_error"]
print(f"(estimate - truth) / standard error: standard deviation {deviation.std():.2f}")

figure, axes = plt.subplots(1, 2, sharey=True)
maps = {"true lifetime": lifetime, "identified": table["tau"].to_numpy().reshape(rows.shape)}
for ax, (title, values) in zip(axes, maps.items(), strict=True):
    picture = ax.imshow(values, vmin=1.2, vmax=3.2, cmap="viridis")
    ax.set(title=title, xlabel="column [pixel]")
    ax.grid(False)
axes[0].set_ylabel("row [pixel]")
figure.colorbar(picture, ax=axes, label="lifetime [ns]", shrink=0.85)
figure.savefig("many_fits.png")
