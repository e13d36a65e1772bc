"""Write conf/problem of the published problems: each published fit in two boxes, by rule.

python -m experiments.check.published_problems

The evidence in an existing file is kept; `experiments.check.optima` finds it.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from omegaconf import OmegaConf

from baselines.problems import PublishedFit, PublishedModel, published_fit, published_names

PROBLEMS = Path(__file__).parents[2] / "conf" / "problem"
WIDTH = 100
AROUND = 100.0
"""Factor from a certified value to either end of its logarithmic box."""
SPREADS = 10.0
LEAST_SPREAD = 0.1
"""Smallest spread relative to the published value, if the starting values are close to it."""
ROUNDING = 1e-12
"""Relative error of the data; a smaller error is rounding, or due to the digits of the data."""
DIGITS = 1e-6
"""Relative error of a parameter with six correct digits."""


@dataclass(frozen=True)
class Box:
    """The range of one parameter."""

    low: float
    high: float
    scale: str = "linear"

    @property
    def yaml(self) -> str:
        """Settings of the parameter as in `conf/space`."""
        scale = "" if self.scale == "linear" else f", scale: {self.scale}"
        return f'{{unit: "-", low: {number(self.low)}, high: {number(self.high)}{scale}}}'


def around(fit: PublishedFit, k: int) -> Box:
    """Two powers of ten on either side of a positive value; ten times a negative one either way."""
    value = fit.optimum[k]
    if value > 0:
        return Box(value / AROUND, value * AROUND, "log")
    return Box(-math.sqrt(AROUND) * -value, math.sqrt(AROUND) * -value)


def decades(fit: PublishedFit, k: int) -> Box:
    """Whole powers of ten, at least one beyond the value, which a negative one has either way."""
    value = fit.optimum[k]
    exponent = math.floor(math.log10(abs(value)))
    if value > 0:
        return Box(10.0 ** (exponent - 1), 10.0 ** (exponent + 2), "log")
    return Box(-(10.0 ** (exponent + 2)), 10.0 ** (exponent + 2))


def starts(fit: PublishedFit, k: int) -> Box:
    """Ten times as wide as the spread of the published starts and the value, around its middle."""
    values = [fit.optimum[k], *(start[k] for start in fit.starts)]
    low, high = min(values), max(values)
    half = SPREADS / 2 * max(high - low, LEAST_SPREAD * abs(fit.optimum[k]))
    return Box((low + high) / 2 - half, (low + high) / 2 + half)


BOXES: Mapping[str, tuple[Callable[[PublishedFit, int], Box], str]] = {
    "log": (
        around,
        "a hundredth of a positive value to a hundred times it, logarithmic; ten times a negative "
        "one either way, linear",
    ),
    "decades": (
        decades,
        "powers of ten, at least one beyond a positive value on both sides, logarithmic; either "
        "way for a negative one, linear",
    ),
    "starts": (
        starts,
        "linear, ten times as wide as the spread of the published starts and the optimum, around "
        "the middle of these",
    ),
}
"""Rules for a range, with their descriptions."""
CHOSEN = {"nist": ("log", "starts")}
OTHERS = ("decades", "starts")
SOURCES = {
    "nist": "certified by NIST",
    "mgh": "printed by More, Garbow and Hillstrom",
    "bw": "printed by Bates and Watts, or in gslnls",
    "r": "printed by R",
}
"""Source of an optimum by collection, unless the data have no errors."""
EXACT = "the data have no errors"


def problems() -> dict[str, tuple[PublishedFit, str]]:
    """All published problems and the names of their boxes, by name in conf/problem."""
    posed = {}
    for fit in map(published_fit, published_names()):
        for box in CHOSEN.get(fit.collection, OTHERS):
            posed[f"{fit.collection}_{fit.name}_{box}"] = fit, box
    return posed


def optimum_of(fit: PublishedFit) -> float:
    """Root of the mean square from the published sum of squares."""
    return math.sqrt(fit.squares / len(fit.dataset))


def resolution_of(fit: PublishedFit) -> float:
    """Error at which the least certain parameter still has six digits, rounded down to one digit.

    At an error s of exact data, parameter k is off by at most s ((J'J / N)^-1_kk)^(1/2).
    """
    model = PublishedModel(fit.model)
    theta = np.array(fit.optimum)
    J = model.jacobian(theta, *(fit.dataset[name] for name in model.inputs))
    _, sizes, directions = np.linalg.svd(J * theta / math.sqrt(len(J)), full_matrices=False)
    worst = float(np.sqrt(((directions.T / sizes) ** 2).sum(axis=1)).max())
    return rounded_down(DIGITS / worst)


def rounded_down(value: float) -> float:
    """A positive value, rounded down to one digit."""
    unit = 10.0 ** math.floor(math.log10(value))
    return float(f"{math.floor(value / unit) * unit:.0e}")


def yaml_of(name: str, fit: PublishedFit, box: str, evidence: str) -> str:
    """Text of the file of a problem in conf/problem."""
    rule, meaning = BOXES[box]
    names = PublishedModel(fit.model).parameters
    size = f"{len(fit.optimum)} parameters, {len(fit.dataset)} rows. Box: {meaning}."
    optimum = optimum_of(fit)
    exact = optimum < ROUNDING * float(np.sqrt(np.mean(fit.dataset["y"] ** 2)))
    facts = {"name": name, "family": fit.model, "optimum": number(optimum)}
    facts |= {"resolution": number(resolution_of(fit))} if exact else {}
    settings = [f"dataset: {{name: {fit.name}}}", f"model: {{name: {fit.model}}}"]
    space = {parameter: rule(fit, k) for k, parameter in enumerate(names)}
    about = [f"{fit.title}.", size]
    return problem_yaml("published_problems", about, settings, facts, evidence, space)


def problem_yaml(
    writer: str, about: Sequence[str], settings: Sequence[str], facts: Mapping[str, str],
    evidence: str, space: Mapping[str, Box], groups: tuple[str, str] = ("published", "published"),
) -> str:  # fmt: skip
    """Text of a file in conf/problem, by the check `writer`; `groups`: of dataset and model."""
    lines = [
        "# @package _global_",
        *(line for text in about for line in comment(text)),
        f"# Written by experiments.check.{writer}: change the rule, not this file.",
        "defaults:",
        f"  - override /dataset: {groups[0]}",
        f"  - override /model: {groups[1]}",
        "  - override /space: null",
        "",
        *settings,
        "",
        "problem:",
        *(f"  {key}: {text}" for key, text in facts.items()),
        "  evidence: >-",
        *(f"    {line}" for line in textwrap.wrap(evidence, WIDTH - 4)),
        "",
        "space:",
        *(f"  {name}: {box.yaml}" for name, box in space.items()),
    ]
    return "\n".join(lines) + "\n"


def evidence_in(file: Path, fit: PublishedFit) -> str:
    """Evidence for the optimum in the file of a problem, else from its publication."""
    if file.exists():
        return str(OmegaConf.load(file).problem.evidence)
    return SOURCES[fit.collection] if fit.squares else EXACT


def files() -> dict[Path, str]:
    """Paths and texts of all files by the rule."""
    texts = {}
    for name, (fit, box) in problems().items():
        file = PROBLEMS / f"{name}.yaml"
        texts[file] = yaml_of(name, fit, box, evidence_in(file, fit))
    return texts


def comment(text: str) -> list[str]:
    """Lines of a YAML comment."""
    return textwrap.wrap(text, WIDTH, initial_indent="# ", subsequent_indent="# ")


def number(value: float) -> str:
    """Text of a float for YAML with fourteen digits, so that rounding does not show."""
    text = f"{value:.14g}"
    mantissa, e, exponent = text.partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}{e}{exponent}"


def write(texts: Mapping[Path, str]) -> None:
    """Write the files and print their number."""
    for file, text in texts.items():
        file.write_text(text, encoding="utf-8")
    print(f"{len(texts)} files in {PROBLEMS}")


def main() -> None:
    """Write all files."""
    write(files())


if __name__ == "__main__":
    main()
