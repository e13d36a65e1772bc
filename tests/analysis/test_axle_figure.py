"""Fig. 4, right: data as points, curves solid where they were learned."""

import numpy as np

from miho.analysis.figures.paper import AxleCurve, fig4, fig4_right


def test_curves_are_solid_where_they_were_learned() -> None:
    alpha = np.linspace(-10, 10, 201)
    curve = AxleCurve((alpha, -alpha), 0.25, (-3.0, 1.0))
    data = np.linspace(-2, 1, 50), np.linspace(2, -1, 50)
    ax = fig4_right(data, {"laps": curve}, note="a note").axes[0]
    whole, solid = ax.lines
    assert len(whole.get_xdata()) == alpha.size
    assert (min(solid.get_xdata()), max(solid.get_xdata())) == (-3.0, 1.0)
    assert solid.get_label() == "laps, error 0.25 kN"
    assert ax.collections[0].get_offsets().shape == (50, 2)
    assert ax.get_xlim()[1] == 3.0


def test_fig4_has_the_axle_as_a_third_panel() -> None:
    alpha = np.linspace(-12, 12, 201)
    tires = {tire: (alpha, -np.tanh(alpha)) for tire in ("LF", "RF", "LR", "RR")}
    curve = AxleCurve((alpha, -2 * np.tanh(alpha)), 0.26, (-12.0, 12.0))
    axes = fig4(tires, tires, axle=(tires["LF"], {"with load transfer": curve})).axes
    assert [ax.get_title(loc="left") for ax in axes] == [
        "front tires", "rear tires", "front axle, unseen drive",
    ]  # fmt: skip
    assert axes[2].get_xlim() == axes[0].get_xlim()
    assert axes[2].get_ylabel() == "lateral force, both tires [kN]"
    labels = [text.get_text() for text in axes[2].get_legend().get_texts()]
    assert labels == ["with load transfer, error 0.26 kN"]
    assert len(fig4(tires, tires).axes) == 2
