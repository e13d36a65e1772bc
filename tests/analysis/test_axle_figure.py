"""Fig. 4, right: data as points, curves solid where they were learned."""

import numpy as np

from miho.analysis.figures.paper import AxleCurve, fig4_right


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
