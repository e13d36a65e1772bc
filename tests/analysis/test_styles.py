from __future__ import annotations

from pathlib import Path

import seaborn as sns

from miho.analysis.styles import MAIN, STYLES, styles_of, with_emphasis
from miho.figures.style import COLORS

ROOT = Path(__file__).parents[2]


def test_every_optimizer_of_the_configuration_has_a_fixed_style() -> None:
    names = [path.stem for path in (ROOT / "conf" / "optimizer").glob("*.yaml")]
    assert len(names) > 8
    assert set(names) <= set(STYLES)


def test_all_looks_and_names_differ() -> None:
    assert len({(style.color, style.dashes) for style in STYLES.values()}) == len(STYLES)
    assert len({style.name for style in STYLES.values()}) == len(STYLES)


def test_spare_styles_differ_from_fixed_ones() -> None:
    unnamed = [f"variant_{letter}" for letter in "abcdefgh"]
    styles = styles_of([*STYLES, *unnamed])
    assert len({(style.color, style.dashes) for style in styles.values()}) == len(styles)
    assert styles["variant_a"].name == "variant a"


def test_the_foreground_comes_last_and_keeps_its_style() -> None:
    styles = with_emphasis(["cma_es", "tiktak"])
    assert list(styles)[-1] == "cma_es"
    assert styles["cma_es"] == STYLES["cma_es"]
    assert styles["tiktak"] == STYLES["tiktak"].muted
    assert styles["tiktak"].name == STYLES["tiktak"].name


def test_by_default_the_main_methods_stand_out() -> None:
    styles = with_emphasis(STYLES)
    assert {method for method, style in styles.items() if style != style.muted} == set(MAIN)


def test_a_method_of_the_user_stands_out() -> None:
    styles = with_emphasis([*STYLES, "firefly", "tiktak screen=10"])
    assert styles["firefly"] != styles["firefly"].muted
    assert styles["tiktak screen=10"] == styles["tiktak screen=10"].muted


def test_the_colours_are_those_that_seaborn_calls_colorblind() -> None:
    assert list(COLORS) == sns.color_palette("colorblind").as_hex()
    assert {STYLES[name].color for name in ("miho", "cma_es", "pso_100", "optuna_tpe")} <= {*COLORS}
