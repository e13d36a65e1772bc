"""Write conf/problem of two published sets of least-squares problems for optimization.

python -m experiments.check.residual_problems

`mw_...` are the 53 problems of Moré and Wild (SIAM J. Optim. 20, 2009), `cr_...` systems of Cartis
and Roberts (Math. Prog. Comp. 11, 2019) that exist for eight to twelve variables. A system is used
if its formula gives their printed sum of squares at the starting point, or if it is in an older
publication (`baselines.problems.cartis_roberts`). A name ends in the number of variables, and in
`far` if the starting point is ten times as far from zero.

Both sets are unconstrained. Here, each variable has a box around its starting value x, from
x - 10 s to x + 10 s with s = max(1, |x|), cut if the publication keeps a variable positive.

The optimum and its evidence in an existing file are kept; `experiments.check.optima` finds both.
The optimum of exact equations is 0; an error below ARRIVED times the error at the starting point
counts as 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from omegaconf import OmegaConf

from baselines.problems import PublishedFit, PublishedModel, ResidualSystem, published_fit
from experiments.check.published_problems import (
    PROBLEMS,
    Box,
    number,
    optimum_of,
    problem_yaml,
    rounded_down,
    write,
)
from miho.quantities import Array

AROUND = 10.0
"""Half the width of a box in multiples of max(1, |x|) at the starting value x. With 10, all
published optima but one are inside: x9 of Watson's function of twelve variables is at a bound, and
inside for the far starting point."""
FAR = 10.0
"""Factor of Moré and Wild between the first and the second starting point."""
ARRIVED = 1e-6
"""An error below this share of the error at the starting point counts as zero. The smallest other
optimum has 2.5e-6 of it (Watson's function of twelve variables); rounding gives 1e-16."""
MORE_WILD: Mapping[str, tuple[tuple[int, ...], tuple[int, ...]]] = {
    "linear_full_rank": ((9,), (9,)),
    "linear_rank_1": ((7,), (7,)),
    "linear_rank_1_zeros": ((7,), (7,)),
    "rosenbrock": ((2,), (2,)),
    "helical_valley": ((3,), (3,)),
    "powell_singular": ((4,), (4,)),
    "freudenstein_roth": ((2,), (2,)),
    "bard": ((3,), (3,)),
    "kowalik_osborne": ((4,), ()),
    "meyer": ((3,), ()),
    "watson": ((6, 9, 12), (6, 9, 12)),
    "box_3d": ((3,), ()),
    "jennrich_sampson": ((2,), ()),
    "brown_dennis": ((4,), (4,)),
    "chebyquad": ((6, 7, 8, 9, 10, 11), ()),
    "brown_almost_linear": ((10,), ()),
    "osborne_1": ((5,), ()),
    "osborne_2": ((11,), (11,)),
    "bdqrtic": ((8, 10, 11, 12), ()),
    "cube": ((5, 6, 8), ()),
    "mancino": ((5, 8, 10, 12), (5, 12)),
    "heart_8": ((8,), (8,)),
}
"""Numbers of variables of each function, and the numbers that also have a far starting point."""
FITS: Mapping[str, tuple[str, tuple[float, ...]]] = {
    "bard": ("bard", (1.0, 1.0, 1.0)),
    "kowalik_osborne": ("mgh09", (0.25, 0.39, 0.415, 0.39)),
    "meyer": ("mgh10", (0.02, 4000.0, 250.0)),
    "jennrich_sampson": ("jennrich", (0.3, 0.4)),
    # The third is -1 in More, Garbow and Hillstrom.
    "osborne_1": ("mgh17", (0.5, 1.5, 1.0, 0.01, 0.02)),
    "osborne_2": ("osborne2", (1.3, 0.65, 0.65, 0.7, 0.6, 3.0, 5.0, 7.0, 2.0, 4.5, 5.5)),
}
"""Functions of Moré and Wild that are also published fits here, and their starting points."""
CARTIS_ROBERTS: Mapping[str, int] = {
    "argtrig": 10, "artif": 10, "arwhdne": 10, "bdvalues": 10, "bratu2d": 9, "bratu2dt": 9,
    "bratu3d": 8, "brown_almost_linear": 12, "broydn3d": 10, "broydnbd": 10, "cbratu2d": 8,
    "chandheq": 10, "chebyshev_rosenbrock": 10, "chemrcta": 10, "chemrctb": 10, "chnrsbne": 10,
    "eigena": 12, "eigenb": 12, "freudenstein_roth": 10, "integreq": 10, "luksan11": 10,
    "luksan12": 11, "luksan13": 11, "luksan14": 11, "luksan17": 10, "luksan21": 10, "morebvne": 10,
    "msqrta": 9, "msqrtb": 9, "penlt1ne": 10, "penlt2ne": 10, "powell_singular": 12, "spmsqrt": 10,
    "vardimne": 10, "yatp1ne": 8, "yatp2ne": 8,
}  # fmt: skip
"""Number of variables of each system: ten, or the closest that its structure allows."""
TITLES = {
    "mw": "one of the 53 problems of More and Wild (2009)",
    "cr": "a system of CUTEst in the table of Cartis and Roberts (2019)",
}


@dataclass(frozen=True)
class Posed:
    """A problem: name of the function, number of variables, and factor of the starting point."""

    collection: str
    function: str
    length: int
    factor: float = 1.0

    @property
    def name(self) -> str:
        """Name in conf/problem."""
        far = "_far" if self.factor != 1 else ""
        return f"{self.collection}_{self.function}_{self.length}{far}"

    @property
    def fit(self) -> PublishedFit | None:
        """Published fit of the function, or None."""
        return published_fit(FITS[self.function][0]) if self.function in FITS else None

    @property
    def system(self) -> ResidualSystem:
        """System of residuals of a function without a published fit."""
        return ResidualSystem(self.function, self.length)

    @property
    def start(self) -> Array:
        """Starting point of the publication (n,)."""
        near = FITS[self.function][1] if self.function in FITS else self.system.start
        return np.asarray(self.factor * np.array(near))

    @property
    def rows(self) -> int:
        """The number of residuals."""
        return len(self.fit.dataset) if self.fit else self.system.size

    def residuals(self, theta: Array) -> Array:
        """Residuals (m,) at one configuration (n,)."""
        if self.fit is None:
            return np.asarray(self.system.predict(theta[None], np.arange(1.0, self.rows + 1))[0])
        model = PublishedModel(self.fit.model)
        inputs = (self.fit.dataset[column] for column in model.inputs)
        return np.asarray(model.predict(theta[None], *inputs)[0] - self.fit.dataset["y"])

    @property
    def box(self) -> dict[str, Box]:
        """The range of each variable."""
        start = self.start
        half = AROUND * np.maximum(1.0, np.abs(start))
        low = start - half
        if self.fit is None and self.system.published.low is not None:
            low = np.maximum(low, self.system.published.low(self.length))
        names = PublishedModel(self.fit.model).parameters if self.fit else self.system.parameters
        return {
            name: Box(float(a), float(b))
            for name, a, b in zip(names, low, start + half, strict=True)
        }

    @property
    def resolution(self) -> float:
        """Error below which an optimum is zero, from the near starting point, to one digit."""
        residuals = self.residuals(self.start / self.factor)
        return rounded_down(ARRIVED * math.sqrt(np.mean(residuals**2)))


def problems() -> Iterator[Posed]:
    """All problems of both sets; Moré and Wild in the published order."""
    for function, (near, far) in MORE_WILD.items():
        for length in near:
            yield Posed("mw", function, length)
            if length in far:
                yield Posed("mw", function, length, FAR)
    for function, length in CARTIS_ROBERTS.items():
        yield Posed("cr", function, length)


def yaml_of(posed: Posed, optimum: float, evidence: str) -> str:
    """Text of the file of a problem in conf/problem."""
    start = "published start" if posed.factor == 1 else "published start times ten"
    about = (
        f"{posed.function}, {TITLES[posed.collection]}: {posed.length} variables, {posed.rows} "
        f"residuals. Box: ten times max(1, |x|) around the {start} x of each variable, either way."
    )
    facts = {"name": posed.name, "family": posed.function, "optimum": number(optimum)}
    facts |= {"resolution": number(posed.resolution)} if optimum < posed.resolution else {}
    groups = ("published", "published") if posed.fit else ("zero_residuals", "residual_system")
    settings = [
        f"dataset: {{rows: {posed.rows}}}",
        f"model: {{system: {posed.function}, length: {posed.length}}}",
    ]
    if posed.fit:
        settings = [f"dataset: {{name: {posed.fit.name}}}", f"model: {{name: {posed.fit.model}}}"]
    return problem_yaml("residual_problems", [about], settings, facts, evidence, posed.box, groups)


def recorded(posed: Posed, file: Path) -> tuple[float, str]:
    """Optimum and evidence in the file of a problem, else from the publication."""
    if file.exists():
        problem = OmegaConf.load(file).problem
        return float(problem.optimum), str(problem.evidence)
    return optimum_of(posed.fit) if posed.fit else 0.0, "not looked for"


def files() -> dict[Path, str]:
    """Paths and texts of all files by the rule."""
    texts = {}
    for posed in problems():
        file = PROBLEMS / f"{posed.name}.yaml"
        texts[file] = yaml_of(posed, *recorded(posed, file))
    return texts


def main() -> None:
    """Write all files."""
    write(files())


if __name__ == "__main__":
    main()
