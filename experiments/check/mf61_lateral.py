"""Accuracy of MF 6.1 lateral coefficients: identified, written to a file, simplified and rebuilt.

    python -m experiments.check.mf61_lateral [FOLDER]

For each embedded tire, and for the MF 6.1 tire in the folder mf_reference of FOLDER (else of
MIHO_DATA_DIR, else of ../shared/data next to the checkout) if it exists: 27 coefficients from 3000
noisy samples (`sample_lateral`), least squares from uniform starting points in
conf/space/mf61_lateral, judged against the tire at loads and cambers that were not in the data.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from time import process_time

import numpy as np
import pandas as pd
import scipy.optimize
from threadpoolctl import threadpool_limits

from experiments.app.build import build, build_space
from experiments.app.compose import composed
from experiments.app.schema import register
from experiments.check import reference_data
from miho.analysis.compare.running_time import NEAR_BEST
from miho.identification import CurveFit
from miho.optim import Budget, Space, minimize
from miho.quantities import Array
from miho.vehicle.data import embedded_tire, sample_lateral
from miho.vehicle.models import (
    LateralMagicFormula,
    from_simplified,
    load_tir,
    mf61_lateral,
    simplify,
    write_tir,
)
from miho.vehicle.models.lateral_magic_formula import COEFFICIENTS
from miho.vehicle.models.magic_formula import MagicFormula
from miho.vehicle.models.simplified_tire import SLIP

STARTS = 20
LIMIT = 60  # steps of one start


def bare(tire: MagicFormula) -> LateralMagicFormula:
    """The model with only the nominal load, the nominal pressure and the dimensions of the tire."""
    p = tire.parameters
    names = ("FNOMIN", "NOMPRES", "UNLOADED_RADIUS", "LONGVL")
    model = mf61_lateral({name: getattr(p, name) for name in names})
    assert isinstance(model, LateralMagicFormula)
    return model


def configured_space() -> Space:
    """The space of conf/space/mf61_lateral."""
    settings = composed(["model=mf61_lateral", "space=mf61_lateral"]).space
    return build_space({str(k): dict(v) for k, v in settings.items()})


def identification(path: Path, space: Space, starts: int = STARTS) -> dict[str, object]:
    """Uniform starting points on one tire: successes, accuracy of the best one, and cost."""
    tire, data = load_tir(path), sample_lateral(str(path), strict=False)
    problem = CurveFit(bare(tire), data, space)
    held = data.held_out
    assert held is not None
    columns = [held[name] for name in problem.model.inputs]
    alpha, Fz, gamma, pressure = columns
    truth = tire.forces(Fz, 0, alpha, gamma, pressure=pressure).Fy
    peak = np.abs(truth).max()
    rng = np.random.default_rng(0)
    errors, seconds, unseen = [], [], []
    for start in rng.uniform(space.low, space.high, (starts, len(space))):
        began = process_time()
        fit = scipy.optimize.least_squares(
            problem.residuals, start, jac=problem.jacobian, bounds=(space.low, space.high),
            x_scale="jac", max_nfev=LIMIT,
        )  # fmt: skip
        seconds.append(process_time() - began)
        errors.append(np.sqrt(2 * fit.cost / len(data)))
        predicted = problem.model.predict(fit.x[None], *columns)[0]
        unseen.append(100 * np.sqrt(np.mean((predicted - truth) ** 2)) / peak)
    success = np.array(errors) < NEAR_BEST * min(errors)
    best = int(np.argmin(errors))
    return {
        "tire": path.stem,
        "peak [N]": round(float(peak)),
        "starts that succeed": f"{success.sum()} of {starts}",
        "training RMSE [N]": errors[best],
        "unseen RMSE against the tire [% of peak]": unseen[best],
        "median CPU s per start": float(np.median(seconds)),
    }


def round_trips(path: Path) -> dict[str, object]:
    """Largest force errors over the peak of each curve: simple curves, and rebuilt tires."""
    tire = load_tir(path)
    p = tire.parameters
    cambers, pressures = np.radians([-4, -2, 0, 2, 4]), p.NOMPRES * np.array([0.85, 1, 1.15])
    table = simplify(tire, p.FNOMIN * np.array([0.35, 0.7, 1, 1.5, 2.1]), cambers, pressures)
    row = table.Fz[:, None], table.gamma[:, None], table.pressure[:, None]
    true = tire.forces(row[0], 0, SLIP, row[1], pressure=row[2]).Fy
    peak = np.abs(true).max(axis=1, keepdims=True)

    def error(force: Array) -> str:
        return f"{(np.abs(force - true) / peak).max():.1e}"

    def rebuilt(asymmetry: Array) -> str:
        again = from_simplified(table._replace(asymmetry=asymmetry), bare(tire).base)
        return error(again.forces(row[0], 0, SLIP, row[1], pressure=row[2]).Fy)

    return {
        "tire": path.stem,
        "curves": table.Fz.size,
        "one E": error(table.force(SLIP)),
        "E per side": error(table.force(SLIP, two_sided=True)),
        "rebuilt from one E": rebuilt(np.zeros_like(table.E)),
        "rebuilt from E per side": rebuilt(table.asymmetry),
    }


def whole_run() -> None:
    """dataset=tire_lf_conditions optimizer=least_squares, and its tire through a file."""
    experiment = build(composed(["dataset=tire_lf_conditions", "optimizer=least_squares"]))
    problem, model = experiment.problem, experiment.problem.model
    assert isinstance(model, LateralMagicFormula)
    record = minimize(experiment.optimizer, problem, Budget(), seed=0)
    assert record.theta is not None
    print(
        f"\noptimizer=least_squares: RMSE {np.sqrt(record.loss):.3f} N, "
        f"{record.evaluations} evaluations, {record.seconds:.1f} s"
    )
    tire = model.with_coefficients(record.theta)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "identified.tir"
        write_tir(tire, path)
        again = load_tir(path)
    columns = [problem.dataset[name] for name in model.inputs]
    alpha, Fz, gamma, pressure = columns
    force = model.predict(record.theta[None], *columns)[0]
    difference = again.forces(Fz, 0, alpha, gamma, pressure=pressure).Fy - force
    print(f"written, read and evaluated: {np.abs(difference).max():.1e} N from the model")


def main() -> None:
    """Print all figures, with one thread."""
    with threadpool_limits(1):
        figures()


def figures() -> None:
    """All figures."""
    register()
    tires = [embedded_tire(name) for name in ("lf", "rf", "lr", "rr")]
    tires += [
        path
        for path in sorted((reference_data() / "mf_reference").glob("*.tir"))
        if load_tir(path).parameters.version == "6.1"
    ]
    print(f"{len(COEFFICIENTS)} coefficients of MF 6.1 from 3000 samples with 50 N of noise")
    space = configured_space()
    print(pd.DataFrame([identification(path, space) for path in tires]).to_string(index=False))
    whole_run()
    print("\nsimple curves of 5 loads x 5 cambers x 3 pressures: largest error over each peak")
    print(pd.DataFrame([round_trips(path) for path in tires]).to_string(index=False))


if __name__ == "__main__":
    main()
