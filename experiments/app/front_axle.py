"""Fig. 4 (right): the front axle from the property data, on a drive that the fit did not use."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from omegaconf import OmegaConf

from experiments.app.build import rebuild
from experiments.app.compose import composed
from miho.analysis.figures.paper import AxleCurve
from miho.data import Dataset
from miho.quantities import Array
from miho.study import StoredRun
from miho.vehicle.driving import LoadTransfer, Sensors, Vehicle, embedded_plant
from miho.vehicle.driving.assembly.bench import loaded_axle
from miho.vehicle.driving.assembly.from_drives import weave_samples
from miho.vehicle.driving.loaded_axle import LoadedAxle, transfer_per_force
from miho.vehicle.driving.proving_ground import perform, weaves

NEAR = 0.8
"""Smallest share of the peak that counts as near the peak."""
RESAMPLES = 2000


class Generalisation(NamedTuple):
    """Root mean square errors of a curve on a drive, all forces in one unit.

    Attributes
    ----------
    error : float
        Error over all rows.
    largest : float
        Largest magnitude of the measured force.
    near, below : float
        Error over the rows near the peaks, and over the other rows.
    ratio : float
        `near` divided by `below`.
    low, high : float
        95 % interval of the ratio.
    """

    error: float
    largest: float
    near: float
    below: float
    ratio: float
    low: float
    high: float

    @property
    def share(self) -> float:
        """The error divided by the largest force."""
        return self.error / self.largest

    @property
    def less_near_the_peaks(self) -> bool:
        """Whether the error near the peaks is significantly larger than below them."""
        return self.low > 1

    def text(self) -> str:
        """The figures as text, with forces in N."""
        return (
            f"error {self.error:.0f} N, {100 * self.share:.1f} % of the largest force "
            f"({self.largest:.0f} N); near the peaks {self.near:.0f} N, {self.ratio:.2f} "
            f"[{self.low:.2f}, {self.high:.2f}] times the {self.below:.0f} N below"
        )


def near_peaks(force: Array, peaks: tuple[float, float]) -> NDArray[np.bool_]:
    """Mask (n,) of forces that reach `NEAR` of the lowest or the highest force in `peaks`."""
    low, high = peaks
    return (force <= NEAR * low) | (force >= NEAR * high)


def generalisation(
    measured: Array, predicted: Array, near: NDArray[np.bool_], rng: np.random.Generator
) -> Generalisation:
    """Judge a curve's forces on a drive.

    Errors of neighbouring rows are correlated, so the interval resamples whole swings: from one
    change of the curve's sign to the next.

    Parameters
    ----------
    measured, predicted : ndarray of shape (n,)
        Lateral forces in the order of the drive, and the curve's forces at the same slip angles.
    near : bool ndarray of shape (n,)
        The rows near the peaks, see `near_peaks`.
    rng : numpy.random.Generator
        Draws the swings of each of `RESAMPLES` resamples.

    Returns
    -------
    Generalisation
        The errors and the interval of their ratio.

    Raises
    ------
    ValueError
        If no row, or every row, is near the peaks.
    """
    if near.all() or not near.any():
        raise ValueError(
            f"{near.sum()} of {near.size} rows are near the peaks; expected a drive with some rows "
            "near the peaks and some below"
        )
    square = (predicted - measured) ** 2
    swing = np.concatenate([[0], np.cumsum(np.diff(np.sign(predicted)) != 0)])
    sums = np.array(
        [
            np.bincount(swing, weights=column, minlength=swing[-1] + 1)
            for column in (square * near, near, square * ~near, ~near)
        ]
    )
    picks = rng.integers(sums.shape[1], size=(RESAMPLES, sums.shape[1]))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = _ratio(sums[:, picks].sum(axis=2))
    low, high = np.nanquantile(ratios, [0.025, 0.975])
    total = sums.sum(axis=1)
    return Generalisation(
        error=float(np.sqrt(square.mean())),
        largest=float(np.abs(measured).max()),
        near=float(np.sqrt(total[0] / total[1])),
        below=float(np.sqrt(total[2] / total[3])),
        ratio=float(_ratio(total)),
        low=float(low),
        high=float(high),
    )


def _ratio(sums: Array) -> Array:
    """Error near the peaks divided by the error below, from sums of squares and numbers of rows."""
    return np.asarray(np.sqrt((sums[0] / sums[1]) / (sums[2] / sums[3])))


SLIP = np.linspace(-0.22, 0.22, 881)
"""Slip angles [rad] of the drawn curves, as in the property data."""
AT_LOAD, IN_TURN = "at the drive's load", "with load transfer"


@dataclass(frozen=True, eq=False)
class FrontAxle:
    """The front axle from the property data of two tires, and a drive of a car on the same tires.

    axle: the identified curves. load: load on both wheels at the mean speed of the drive [N].
    transfer: as in `LoadedAxle.in_turn`. drive: sensor data of the axle from 3 weaves up to and
    beyond its peaks. reference: error on the property data over the largest force of the identified
    axle [-].
    """

    axle: LoadedAxle
    load: float
    transfer: float
    drive: Dataset
    reference: float

    @classmethod
    def of(cls, tires: Sequence[StoredRun], seed: int = 0) -> FrontAxle:
        """Axle from the runs on the left and the right tire; `seed` draws the sensor noise."""
        data = [rebuild(run).dataset for run in tires]
        thetas = [np.array(run.result["theta"]) for run in tires]
        axle = loaded_axle(data, thetas)
        losses = sum(run.result["loss"] for run in tires)
        vehicle = car_of_paper()
        rng = np.random.default_rng(seed)
        recordings = [perform(embedded_plant(vehicle), weave) for weave in weaves()]
        logs = [recording.log("weave", Sensors(), rng) for recording in recordings]
        drive = weave_samples(logs, vehicle, "front")
        loads = LoadTransfer(vehicle).wheel_loads(drive["vx"])
        return cls(
            axle,
            float(np.mean(loads.front_left + loads.front_right)),
            transfer_per_force(LoadTransfer(vehicle))[0],
            drive,
            math.sqrt(losses) / float(np.abs(axle.axle.force(SLIP)).max()),
        )

    @property
    def models(self) -> Mapping[str, Callable[[Array], Array]]:
        """Lateral force [N] over the slip angle [rad]: as sampled, and with two corrections."""
        return {
            "as sampled": self.axle.axle.force,
            AT_LOAD: self.axle.at([self.load / 2, self.load / 2]).force,
            IN_TURN: lambda alpha: self.axle.in_turn(alpha, self.load, self.transfer),
        }

    def judged(self) -> Mapping[str, Generalisation]:
        """Accuracy of each model on the drive."""
        judged = {}
        for name, force in self.models.items():
            curve, predicted = force(SLIP), force(self.drive["alpha"])
            near = near_peaks(predicted, (float(curve.min()), float(curve.max())))
            rng = np.random.default_rng(0)
            judged[name] = generalisation(self.drive["Fy"], predicted, near, rng)
        return judged

    def panel(self) -> tuple[tuple[Array, Array], Mapping[str, AxleCurve]]:
        """Data of the panel in `fig4`: points of the drive, and the two curves at its loads."""
        points = np.degrees(self.drive["alpha"]), self.drive["Fy"] / 1000
        learned = float(np.degrees(SLIP[0])), float(np.degrees(SLIP[-1]))
        curves = {
            name: AxleCurve(
                (np.degrees(SLIP), force(SLIP) / 1000), self.judged()[name].error / 1000, learned
            )
            for name, force in self.models.items()
            if name != "as sampled"
        }
        return points, curves

    def note(self) -> str:
        """Note below that panel."""
        judged = self.judged()
        near, turning = (
            f"{accuracy.ratio:.2f} [{accuracy.low:.2f}, {accuracy.high:.2f}]"
            for accuracy in (judged[AT_LOAD], judged[IN_TURN])
        )
        return (
            f"the front tires' curves at {self.load / 1000:.1f} kN on both wheels, over "
            f"{len(self.drive['Fy'])} samples of a simulated drive on the same tires; near the "
            f"peaks the error is {near} times the error below, with load transfer {turning}"
        )


def verdict(axle: FrontAxle) -> list[str]:
    """Judgement on the paper's claim about the right panel of Fig. 4, one line for each model."""
    sampled = float(axle.axle.loads.sum())
    lines = [
        f"front axle, learned from property data, over {len(axle.drive['Fy'])} samples of a drive "
        f"that was not used; sampled at {sampled:.0f} N, driven at {axle.load:.0f} N",
    ]
    for name, accuracy in axle.judged().items():
        holds = accuracy.share <= axle.reference
        words = (
            f"{'holds' if holds else 'does not hold'} over the whole drive (property data: "
            f"{100 * axle.reference:.1f} %), "
            f"{'less' if accuracy.less_near_the_peaks else 'no less'} accurate near the peaks"
        )
        lines.append(f"{name}: {accuracy.text()}: {words}")
    return lines


def facts(axle: FrontAxle) -> dict[str, Any]:
    """Facts about the right panel, for the provenance file of the figure."""
    return {
        "drive": axle.drive.digest,
        "load": axle.load,
        "sampled_at": axle.axle.loads.tolist(),
        "peak_sensitivity": np.asarray(axle.axle.sensitivity.peak).tolist(),
        "stiffness_sensitivity": np.asarray(axle.axle.sensitivity.stiffness).tolist(),
        "reference": axle.reference,
        "models": {name: accuracy._asdict() for name, accuracy in axle.judged().items()},
        "verdict": verdict(axle),
    }


def car_of_paper() -> Vehicle:
    """The car of the paper with the parameters of the simulation."""
    settings = composed(["+vehicle@drive.vehicle=av21_full"]).drive.vehicle
    return Vehicle.from_settings(cast(dict[str, Any], OmegaConf.to_container(settings)))
