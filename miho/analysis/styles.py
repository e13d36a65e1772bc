"""The fixed style of each method in figures: a colour-blind-safe colour, a line style, a name.

Families share a hue: MIHO and Hyperband's variants are red and pink, evolution and annealing blue,
swarms sky blue, methods that model the loss green, local descent tan, least squares black, other
global searches that use residuals brown. Members differ by dashes, which also distinguish them in
black and white.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from miho.figures.style import BLUE, COLORS, GREEN, ORANGE, RED

_PINK, _TAN, _SKY = COLORS[4], COLORS[5], COLORS[9]
_BLACK, _GREY, _MUTED, _PURPLE = "#222222", "#6e6e6e", "#8a8a8a", "#6a3d9a"
_BROWN = "#6b3e12"
_INDIGO = "#4b0082"

Dashes = tuple[float, tuple[float, ...] | None]

SOLID: Dashes = (0, None)
DASHED: Dashes = (0, (5, 1.5))
DOTTED: Dashes = (0, (1, 1.2))
DASH_DOT: Dashes = (0, (6, 1.5, 1, 1.5))
DASH_DOT_DOT: Dashes = (0, (6, 1.5, 1, 1.5, 1, 1.5))
SHORT_DASHES: Dashes = (0, (2.5, 1.2))
LONG_DASHES: Dashes = (0, (9, 1.5))
LOOSE_DOTS: Dashes = (0, (1, 3))


@dataclass(frozen=True)
class MethodStyle:
    """Style of a method in figures.

    `dashes` is matplotlib's (offset, on-off pattern in line widths); `width` is in points.
    """

    name: str
    color: str
    dashes: Dashes
    width: float = 1.3

    @property
    def line(self) -> dict[str, Any]:
        """Keyword arguments of `Axes.plot`."""
        return {"color": self.color, "linestyle": self.dashes, "linewidth": self.width}

    @property
    def muted(self) -> MethodStyle:
        """The same method in the background: thin, grey and solid."""
        return replace(self, color=_MUTED, dashes=SOLID, width=0.6)


STYLES = {
    "miho_gn": MethodStyle("MIHO-GN", RED, SHORT_DASHES, 2.2),
    "miho_gn_asynchronous": MethodStyle("MIHO-GN, asynchronous", RED, DASHED, 1.8),
    "miho_qn": MethodStyle("MIHO-QN", _PINK, SHORT_DASHES, 1.8),
    "miho": MethodStyle("MIHO", RED, SOLID, 2.2),
    "miho_reference": MethodStyle("MIHO, public code", _PINK, DASHED, 1.6),
    "miho_no_mutation": MethodStyle("MIHO, no mutation", RED, DOTTED, 1.6),
    "hyperband": MethodStyle("Hyperband", _PINK, SOLID),
    "successive_halving": MethodStyle("successive halving", _PINK, DOTTED),
    "optuna_hyperband": MethodStyle("Optuna Hyperband", _PINK, DASH_DOT_DOT),
    "dehb": MethodStyle("DEHB", RED, DASH_DOT),
    "gbo_small": MethodStyle("GBO-small", _TAN, DOTTED),
    "gbo_large": MethodStyle("GBO-large", _TAN, DASH_DOT),
    "lbfgsb": MethodStyle("L-BFGS-B", _TAN, SOLID),
    "nelder_mead": MethodStyle("Nelder-Mead", _TAN, DASHED),
    "pso_100": MethodStyle("PSO-100", _SKY, DASHED),
    "pso_500": MethodStyle("PSO-500", _SKY, DASH_DOT_DOT),
    "pso_constriction": MethodStyle("PSO constriction", _SKY, DOTTED, 1.6),
    "cma_es": MethodStyle("CMA-ES", BLUE, SOLID, 1.6),
    "optuna_cmaes": MethodStyle("Optuna CMA-ES", BLUE, DASHED),
    "differential_evolution": MethodStyle("differential evolution", BLUE, DASH_DOT),
    "dual_annealing": MethodStyle("dual annealing", BLUE, DOTTED, 1.6),
    "ngopt": MethodStyle("NGOpt", BLUE, DASH_DOT_DOT),
    "optuna_tpe": MethodStyle("Optuna TPE", GREEN, DOTTED, 1.6),
    "random": MethodStyle("random search", _GREY, SHORT_DASHES),
    "least_squares": MethodStyle("least squares", _BLACK, SOLID, 1.0),
    "least_squares_lm": MethodStyle("least squares LM", _BLACK, DASHED, 1.0),
    "variable_projection": MethodStyle("variable projection", _BLACK, DOTTED, 1.6),
    "variable_projection_lm": MethodStyle("variable projection LM", _BLACK, DASH_DOT, 1.0),
    "least_squares_10": MethodStyle("least squares, screen 10", _BLACK, SHORT_DASHES, 1.0),
    "least_squares_50": MethodStyle("least squares, screen 50", _BLACK, LONG_DASHES, 1.0),
    "variable_projection_10": MethodStyle("variable projection, screen 10", _BLACK, LOOSE_DOTS),
    "variable_projection_50": MethodStyle("variable projection, screen 50", _BLACK, DASH_DOT_DOT),
    "hickernell_yuan": MethodStyle("Hickernell-Yuan (gslnls)", _BROWN, SOLID),
    "tiktak": MethodStyle("TikTak", _BROWN, DASHED),
    "cluster_gauss_newton": MethodStyle("cluster Gauss-Newton", _BROWN, DOTTED, 1.6),
    "scatter_search": MethodStyle("scatter search", _BROWN, DASH_DOT),
    "dfo_ls": MethodStyle("DFO-LS", _BROWN, SHORT_DASHES),
}
_SPARE = [
    (color, dashes)
    for dashes in (DASH_DOT, SHORT_DASHES, DASHED, DASH_DOT_DOT)
    for color in (GREEN, _PURPLE, ORANGE)
]


def styles_of(methods: Iterable[str]) -> dict[str, MethodStyle]:
    """The style of each method, in the order of STYLES, then by name.

    Methods without a fixed style take spare styles in the order of their names, so that both panels
    of a figure agree.
    """
    methods = set(methods)
    styles = {method: STYLES[method] for method in STYLES if method in methods}
    for index, method in enumerate(sorted(methods - set(STYLES))):
        color, dashes = _SPARE[index % len(_SPARE)]
        base, _, settings = method.partition(" ")
        name = STYLES[base].name if base in STYLES else base.replace("_", " ")
        styles[method] = MethodStyle(f"{name} {settings}".rstrip(), color, dashes)
    return styles


_RELATED = {
    RED: _INDIGO, _PINK: RED, _TAN: _BROWN, _SKY: BLUE, BLUE: _SKY, GREEN: "#8fb339",
    _BLACK: _GREY, _GREY: _BLACK, _BROWN: _TAN, _PURPLE: _PINK,
    _INDIGO: _PURPLE, ORANGE: _TAN,
}  # fmt: skip
"""The hue of a method whose usual hue is taken by another."""
HUES = tuple(_RELATED)


def distinct(methods: Iterable[str]) -> dict[str, MethodStyle]:
    """`styles_of` with a different hue for each method; for figures of few methods.

    The solid line of a family keeps its hue. The others take the nearest hue that no method in the
    figure has.
    """
    styles = styles_of(methods)
    fixed = {style.color for style in styles.values()}
    free = [hue for hue in HUES if hue not in fixed]
    assigned: dict[str, str] = {}
    for method in sorted(styles, key=lambda method: styles[method].dashes != SOLID):
        color = styles[method].color
        preferences = color, _RELATED.get(color, color), *free
        assigned[method] = next((hue for hue in preferences if hue not in assigned.values()), color)
    return {method: replace(style, color=assigned[method]) for method, style in styles.items()}


MAIN = ("miho_gn", "miho_qn", "miho", "cma_es", "differential_evolution", "optuna_tpe", "pso_500",
        "least_squares", "random")  # fmt: skip
"""Methods in the foreground of a crowded figure: the paper's and one of each family."""


def with_emphasis(methods: Iterable[str]) -> dict[str, MethodStyle]:
    """`styles_of` with all methods in the background muted and placed first.

    Drawn in this order, the foreground is on top: the methods of MAIN and methods without a fixed
    style, such as the user's.
    """
    styles = styles_of(methods)
    secondary = set(STYLES) - set(MAIN)
    back = {name: s.muted for name, s in styles.items() if name.partition(" ")[0] in secondary}
    return back | {name: style for name, style in styles.items() if name not in back}
