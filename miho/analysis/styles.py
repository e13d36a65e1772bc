"""The fixed look of each method: a colour-blind-safe colour, a line style, a printed name."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import seaborn as sns

_BLUE, _ORANGE, _GREEN, _RED, _PINK, _TAN, _LIGHT_PINK, _GREY, _YELLOW, _SKY = sns.color_palette(
    "colorblind"
).as_hex()

Dashes = tuple[float, tuple[float, ...] | None]

SOLID: Dashes = (0, None)
DASHED: Dashes = (0, (5, 1.5))
DOTTED: Dashes = (0, (1, 1.2))
DASH_DOT: Dashes = (0, (6, 1.5, 1, 1.5))
DASH_DOT_DOT: Dashes = (0, (6, 1.5, 1, 1.5, 1, 1.5))
SHORT_DASHES: Dashes = (0, (2.5, 1.2))


@dataclass(frozen=True)
class MethodStyle:
    """`dashes` is matplotlib's (offset, on-off pattern in line widths); `width` is in points."""

    name: str
    color: str
    dashes: Dashes
    width: float = 1.3

    @property
    def line(self) -> dict[str, Any]:
        """Keyword arguments of `Axes.plot`."""
        return {"color": self.color, "linestyle": self.dashes, "linewidth": self.width}


STYLES = {
    "miho": MethodStyle("MIHO", _RED, SOLID, 2.2),
    "miho_reference": MethodStyle("MIHO, public code", _PINK, DASHED, 1.6),
    "gbo_small": MethodStyle("GBO-small", _TAN, DOTTED),
    "gbo_large": MethodStyle("GBO-large", _ORANGE, DASH_DOT),
    "pso_100": MethodStyle("PSO-100", _SKY, DASHED),
    "pso_500": MethodStyle("PSO-500", _BLUE, SOLID),
    "optuna_hyperband": MethodStyle("Optuna Hyperband", _GREEN, DASH_DOT_DOT),
    "random": MethodStyle("random search", _GREY, SHORT_DASHES),
    "least_squares": MethodStyle("least squares", "#222222", SOLID, 1.0),
    "variable_projection": MethodStyle("variable projection", "#222222", DOTTED, 1.6),
}
_SPARE = [
    (color, dashes)
    for dashes in (DASH_DOT, SHORT_DASHES, DASHED, DOTTED)
    for color in ("#222222", _PINK, _GREEN, _BLUE, _TAN)
]


def styles_of(methods: Iterable[str]) -> dict[str, MethodStyle]:
    """The style of each method, in the order of STYLES, then by name.

    Methods without a fixed style take spare ones by the order of their names, so that both
    panels of a figure agree.
    """
    methods = set(methods)
    styles = {method: STYLES[method] for method in STYLES if method in methods}
    for index, method in enumerate(sorted(methods - set(STYLES))):
        color, dashes = _SPARE[index % len(_SPARE)]
        styles[method] = MethodStyle(method.replace("_", " "), color, dashes)
    return styles
