"""One simple curve per load, camber and pressure, and back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from miho.vehicle.data import embedded_tire
from miho.vehicle.models import (
    SimplifiedTire,
    from_simplified,
    load_tir,
    mf61_lateral,
    simplify,
    write_tir,
)
from miho.vehicle.models.lateral_magic_formula import COEFFICIENTS, LateralMagicFormula
from miho.vehicle.models.magic_formula import MagicFormula

LF = load_tir(embedded_tire("lf"))
LOADS, CAMBERS = np.array([1000, 2000, 3114, 5000, 7000.0]), np.radians([-4, -2, 0, 2, 4])
ALPHA = np.linspace(-0.25, 0.25, 33)
ALL = ("FNOMIN", "NOMPRES", "UNLOADED_RADIUS", "LONGVL")


def bare(tire: MagicFormula) -> MagicFormula:
    model = mf61_lateral({name: getattr(tire.parameters, name) for name in ALL})
    assert isinstance(model, LateralMagicFormula)
    return model.base


def off(tire: MagicFormula, table: SimplifiedTire, two_sided: bool) -> float:
    """Largest difference between a table's curves and a tire, over the tire's peaks."""
    row = table.Fz[:, None], table.gamma[:, None], table.pressure[:, None]
    true = tire.forces(row[0], 0, ALPHA, row[1], pressure=row[2]).Fy
    error = np.abs(table.force(ALPHA, two_sided) - true)
    return float((error / np.abs(true).max(axis=1, keepdims=True)).max())


@pytest.mark.parametrize("name", ["lf", "rf", "lr", "rr"])
def test_with_an_e_per_side_the_curve_is_the_tire(name: str) -> None:
    tire = load_tir(embedded_tire(name))
    table = simplify(tire, LOADS, CAMBERS, [120e3, 170e3])
    assert table.Fz.size == 50
    assert off(tire, table, two_sided=True) < 1e-12
    assert 1e-3 < off(tire, table, two_sided=False) < 0.02


def test_it_is_the_reference_tire_too(reference_data: Path) -> None:
    """The forces of these files are checked against MFeval; MF 5.2 has no pressure."""
    for name in ("reference_tire_tvd3", "MagicFormula52_Parameters"):
        tire = load_tir(reference_data / "mf_reference" / f"{name}.tir")
        table = simplify(tire, tire.parameters.FNOMIN * np.array([0.5, 1, 1.5]), CAMBERS)
        assert off(tire, table, two_sided=True) < 1e-12


def test_a_tire_with_equal_sides_needs_no_asymmetry() -> None:
    tire = replace(LF, parameters=replace(LF.parameters, PEY3=0.0, PEY4=0.0))
    table = simplify(tire, LOADS, CAMBERS)
    assert not table.asymmetry.any()
    assert table.residual.max() < 1e-9


def test_the_residual_is_what_the_simple_curve_leaves() -> None:
    table = simplify(LF, 3000.0, 0.03)
    alpha = np.linspace(-0.3, 0.3, 2001)
    true = LF.forces(3000, 0, alpha, 0.03).Fy
    assert np.abs(table.force(alpha)[0] - true).max() == pytest.approx(table.residual[0], rel=0.01)


def test_closed_forms_at_the_nominal_load() -> None:
    p = LF.parameters
    table = simplify(LF, p.FNOMIN)
    assert table.C[0] == p.PCY1
    assert table.D[0] == pytest.approx(p.PDY1 * p.FNOMIN)
    assert table.E[0] == pytest.approx(p.PEY1)
    assert table.asymmetry[0] == pytest.approx(-p.PEY1 * p.PEY3)
    assert (table.Sx[0], table.Sy[0]) == pytest.approx((-p.PHY1, p.PVY1 * p.FNOMIN))
    stiffness = -p.PKY1 * p.FNOMIN * np.sin(p.PKY4 * np.arctan(1 / p.PKY2))
    assert table.B[0] * table.C[0] * table.D[0] == pytest.approx(stiffness)


def test_below_the_smallest_load_the_curve_fades_with_the_tire() -> None:
    tire = replace(LF, parameters=replace(LF.parameters, FZMIN=2000.0))
    assert off(tire, simplify(tire, [500.0, 1000.0], CAMBERS), two_sided=True) < 1e-12


def test_beyond_the_tires_range_of_slip_angles_nothing_is_compared() -> None:
    narrow = replace(LF, parameters=replace(LF.parameters, ALPMIN=-0.1, ALPMAX=0.1))
    table = simplify(narrow, LOADS)
    assert table.residual.max() <= simplify(LF, LOADS).residual.max()
    row = table.Fz[:, None]
    alpha = np.linspace(-0.1, 0.1, 9)
    actual = from_simplified(table, narrow).forces(row, 0, alpha).Fy
    np.testing.assert_allclose(actual, LF.forces(row, 0, alpha).Fy, rtol=1e-9)


def test_back_and_through_a_file_it_is_the_same_tire(tmp_path: Path) -> None:
    table = simplify(LF, LOADS, CAMBERS, [120e3, 145e3, 170e3])
    again = from_simplified(table, bare(LF))
    write_tir(again, tmp_path / "again.tir")
    assert off(load_tir(tmp_path / "again.tir"), table, two_sided=True) < 1e-12
    for name in COEFFICIENTS:
        actual, expected = getattr(again.parameters, name), getattr(LF.parameters, name)
        assert actual == pytest.approx(expected, rel=1e-6, abs=1e-8), name


def test_what_the_table_says_nothing_about_becomes_zero() -> None:
    table = simplify(LF, LOADS)
    again = from_simplified(table, LF)
    assert off(again, table, two_sided=True) < 1e-9
    p = again.parameters
    assert not any((p.PDY3, p.PKY3, p.PVY3, p.PKY6, p.PPY1, p.PPY3)), "camber and pressure"
    assert p.PCX1 == LF.parameters.PCX1, "the longitudinal force is the base's"


def test_from_curves_of_one_e_the_tire_is_as_near_as_they_are() -> None:
    table = simplify(LF, LOADS, CAMBERS)
    simple = table._replace(asymmetry=np.zeros_like(table.E))
    assert off(from_simplified(simple, bare(LF)), simple, two_sided=False) < 1e-9


def test_bad_input_is_named() -> None:
    with pytest.raises(ValueError, match=r"Fz is \[0.0\]; expected finite loads above 0"):
        simplify(LF, 0.0)
    table = simplify(LF, 3000.0)
    with pytest.raises(ValueError, match="not finite"):
        from_simplified(table._replace(B=np.array([np.nan])), LF)
