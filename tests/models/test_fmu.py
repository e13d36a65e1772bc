"""An FMU as a model: an oscillator, compiled here from C, against its closed form."""

import pickle
import shutil
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import miho
from experiments.app.build import build
from experiments.app.compose import composed
from experiments.app.gallery_pages import INTERFACES, build_fmu, description, missing_for_fmu
from miho.identification import make_report
from miho.models import FmuModel
from miho.models.fmu import CO_SIMULATION, MODEL_EXCHANGE

if reason := missing_for_fmu():
    pytest.skip(reason, allow_module_level=True)
T = np.linspace(1.0, 9.0, 201)
K, C, M, START = 8.0, 0.9, 2.0, 0.4


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., str]:
    """The path of an FMU with some of the interfaces."""
    folder = tmp_path_factory.mktemp("fmu")

    def packed(*interfaces: str) -> str:
        path = folder / f"{'_'.join(interfaces)}.fmu"
        if not path.exists():
            build_fmu(path, *interfaces)
        return str(path)

    return packed


def free_swing(k: float, c: float, start: float, t: np.ndarray) -> np.ndarray:
    """x of m x'' = -c x' - k x from rest at `start`."""
    t = t - t[0]
    delta = c / (2 * M)
    omega = np.sqrt(k / M - delta**2)
    return start * np.exp(-delta * t) * (np.cos(omega * t) + delta / omega * np.sin(omega * t))


def ramp_response(k: float, c: float, t: np.ndarray) -> np.ndarray:
    """x from rest at 0 under the force t: (t - c/k) / k and a free swing that starts against it."""
    t = t - t[0]
    delta = c / (2 * M)
    omega = np.sqrt(k / M - delta**2)
    a, b = c / k**2, (delta * c / k**2 - 1 / k) / omega
    return (t - c / k) / k + np.exp(-delta * t) * (a * np.cos(omega * t) + b * np.sin(omega * t))


@pytest.mark.parametrize("interface", INTERFACES)
def test_a_free_swing_is_its_closed_form(fmu: Callable[..., str], interface: str) -> None:
    """1e-11 is RK4 of a millisecond; CVODE to 1e-8 a step is some 1e-6 after a hundred."""
    model = FmuModel(fmu(interface), {"k": "k", "c": "c", "x_0": "start.x"}, ["x"])
    assert (model.inputs, model.output) == ({"t": "s"}, "m")
    assert model.parameters == {"k": "N/m", "c": "N*s/m", "x_0": "m"}
    thetas = np.array([[K, C, START], [12.0, 0.2, -1.0], [K, C, START]])
    values = model.predict(thetas, T)
    exact = np.array([free_swing(*theta, T) for theta in thetas])
    np.testing.assert_allclose(values, exact, atol=3e-6 if interface == MODEL_EXCHANGE else 1e-10)
    np.testing.assert_array_equal(values[0], values[2])  # nothing is left of the row between


def test_derivatives_of_a_simulation(fmu: Callable[..., str]) -> None:
    """Against complex steps; central differences of (h k)^2 x''' / 6 are some 1e-5 off here."""
    model = FmuModel(fmu(CO_SIMULATION), ["k", "c", "start.x"], ["x"])
    theta = np.array([K, C, START])
    moved = theta + 1e-30j * np.eye(3)
    exact = np.array([free_swing(*row, T).imag / 1e-30 for row in moved]).T
    np.testing.assert_allclose(model.jacobian(theta, T), exact, atol=1e-5 * np.abs(exact).max())
    assert model.jacobian_cost == 6


def test_derivatives_beside_a_failure(fmu: Callable[..., str]) -> None:
    """At c = 0, below which there is no value, from c = 0.9e-3 alone: off by h c'' / 2."""
    model = FmuModel(fmu(MODEL_EXCHANGE), ["c", "start.x"], ["x"])
    exact = np.array([free_swing(K, c, START, T) for c in (1e-30j, 0.0)])
    slopes = model.jacobian(np.array([0.0, START]), T)
    np.testing.assert_allclose(slopes[:, 0], exact[0].imag / 1e-30, atol=5e-3)


def test_inputs_are_straight_or_held_amid_a_step(fmu: Callable[..., str]) -> None:
    """CVODE has a ramp at any time. Held at the middle of steps h, x is off by h^2 / 24 x'', and by
    what a parabola is beside its chord: a second order, of which the model says what would help."""
    theta, force = np.array([[K, C]]), T - T[0]
    exact = ramp_response(K, C, T)
    model = FmuModel(fmu(MODEL_EXCHANGE), ["k", "c"], ["x"], ["force"])
    np.testing.assert_allclose(model.predict(theta, T, force)[0], exact, atol=3e-6)
    model = FmuModel(fmu(CO_SIMULATION), ["k", "c"], ["x"], ["force"])
    error = np.abs(model.predict(theta, T, force)[0] - exact).max()
    finer = replace(model, substeps=8).predict(theta, T, force)[0] - exact
    assert np.abs(finer).max() == pytest.approx(error / 64, rel=0.05)
    (remark,) = model.remarks(theta[0], 1e-6, T, force)
    needed = int(remark.split("substeps to ")[1].split(",")[0])
    assert replace(model, substeps=needed).remarks(theta[0], 1e-6, T, force) == []


def test_rows_at_any_times_and_two_outputs(fmu: Callable[..., str]) -> None:
    """Of a swing of some rad/s, straight lines over 0.01 s are off by (2 * 0.01)^2 / 8."""
    model = FmuModel(fmu(CO_SIMULATION), ["k", "c", "start.x"], ["x", "v"], scales=[0.1, 2.0])
    assert (model.inputs, model.output) == ({"t": "s", "output": "-"}, "-")
    t = np.sort(np.random.default_rng(0).uniform(0, 2, 200))
    t[0] = 0.0
    kind = np.repeat([0.0, 1.0], [200, 100])
    theta = np.array([K, C, START])
    values = model.predict(theta[None], np.append(t, t[::2]), kind)[0]
    np.testing.assert_allclose(values[:200], free_swing(*theta, t) / 0.1, atol=1e-3)
    h = 1e-6
    speed = (free_swing(*theta, np.append(0, t + h)) - free_swing(*theta, np.append(0, t - h)))[1:]
    np.testing.assert_allclose(values[200:], (speed / (2 * h) / 2.0)[::2], atol=1e-3)


def test_a_simulation_that_fails_has_no_value(fmu: Callable[..., str]) -> None:
    """An error, a fatal one after which the instance must not be touched, a step without end."""
    for interface in INTERFACES:
        model = FmuModel(fmu(interface), ["k", "c", "start.x"], ["x"], seconds=0.2)
        bad = [[-1.0, C, START], [2e6, C, START]] + [[K, -200.0, START]] * (
            interface == CO_SIMULATION
        )
        reason = r"stopped at t = .*; its limit is 0.2 s" if bad[2:] else r"GetDerivatives failed"
        with pytest.raises(ValueError, match=reason):  # nothing has succeeded yet
            model.predict(np.array(bad[-1:]), T)
        values = model.predict(np.array([*bad, [K, C, START]]), T)
        assert np.isnan(values[:-1]).all(), interface
        np.testing.assert_allclose(values[-1], free_swing(K, C, START, T), atol=3e-6)


def test_an_fmu_is_identified(fmu: Callable[..., str]) -> None:
    """With noise: the truth within four standard errors, and a report without complaints of it."""
    model = FmuModel(fmu(CO_SIMULATION), {"k": "k", "c": "c", "x_0": "start.x"}, ["x"])
    noise = 0.005 * np.random.default_rng(0).standard_normal(T.size)
    x, start = free_swing(K, C, START, T) + noise, {"k": 9.0, "c": 0.5, "x_0": 0.3}
    fit = miho.fit(model, T, x, {"k": (1, 50), "c": (0, 5), "x_0": (-1, 1)}, start=start)
    off = np.abs(fit.theta - [K, C, START]) / fit.parameters["standard_error"]
    assert (off < 4).all()
    report = make_report(fit.problem, fit.theta)
    assert not any("time step" in note for note in report.notes)
    assert fit.problem.model.predict(fit.theta[None], T).shape == (1, T.size)
    again = pickle.loads(pickle.dumps(fit))
    np.testing.assert_array_equal(again.problem.errors(fit.theta), fit.problem.errors(fit.theta))


def test_a_configuration_names_an_fmu(fmu: Callable[..., str], tmp_path: Path) -> None:
    """Its bytes belong to the identity of the run."""
    rows = zip(T, 0 * T, free_swing(K, C, START, T), strict=True)
    lines = [",".join(map(repr, map(float, row))) for row in rows]
    (tmp_path / "swing.csv").write_text("\n".join(["t,force,x", *lines]) + "\n")
    path = shutil.copy(fmu(CO_SIMULATION), tmp_path / "swing.fmu")
    overrides = [
        "model=fmu", f"model.path={path}", "model.identified={k: k, x_0: start.x}",
        "model.outputs=[x]", "model.columns=[force]", "dataset=csv",
        f"dataset.path={tmp_path / 'swing.csv'}", "dataset.columns=[t,force,x]",
        "dataset.units=[s,N,m]", "dataset.output=x",
        "space={k: {unit: N/m, low: 1, high: 50}, x_0: {unit: m, low: -1, high: 1}}",
    ]  # fmt: skip
    experiment = build(composed(overrides))
    assert experiment.problem.loss(np.array([[K, START]]))[0] < 1e-20
    shutil.copy(fmu(*INTERFACES), path)
    assert build(composed(overrides)).identity.code != experiment.identity.code


def test_interfaces_are_chosen(fmu: Callable[..., str]) -> None:
    path, theta = fmu(*INTERFACES), np.array([[K, START]])
    values = {
        interface: FmuModel(path, ["k", "start.x"], ["x"], interface=interface).predict(theta, T)
        for interface in ("", "CoSimulation", "ModelExchange")
    }
    np.testing.assert_array_equal(values[""], values["CoSimulation"])
    assert 1e-10 < np.abs(values[""] - values["ModelExchange"]).max() < 3e-6


def test_bad_input_is_one_line(fmu: Callable[..., str], tmp_path: Path) -> None:
    path = fmu(CO_SIMULATION)
    (tmp_path / "no.fmu").write_text("no zip")
    with zipfile.ZipFile(tmp_path / "other.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", description(CO_SIMULATION))
        archive.writestr("binaries/win64/swing.dll", "")
    for settings, message in {
        ("no.fmu", "k", "x"): "no.fmu: cannot be read as an FMU: File is not a zip file",
        ("other.fmu", "k", "x"): "other.fmu: has binaries for win64, not for linux64; export it",
        (path, "K", "x"): "identified has 'K'; expected one of these variables of .*: k, c, m",
        (path, "k", "y"): r"outputs has 'y'; expected one of .*: k, c, m, start.x, x, v, der\(v\)",
        (path, "force", "x"): "identified has 'force'; expected one of these",
    }.items():
        with pytest.raises(ValueError, match=message):
            FmuModel(str(tmp_path / settings[0]), [settings[1]], [settings[2]])
    for settings, message in {
        ("interface", "ModelExchange"): "interface is 'ModelExchange'; .* has CoSimulation$",
        ("outputs", ("x", "v")): "outputs have the units m, m/s; give scales",
        ("units", "z"): "units has 'z', which is not a name of this model; remove it",
        ("columns", "k"): "columns has 'k'; expected one of .*: force",
    }.items():
        value = {settings[1]: "m"} if settings[0] == "units" else settings[1]
        value = [value] if settings[0] == "columns" else value
        with pytest.raises(ValueError, match=message):
            FmuModel(**{"path": path, "identified": ["k"], "outputs": ["x"], settings[0]: value})
    model = FmuModel(path, ["k"], ["x"])
    with pytest.raises(ValueError, match="t does not increase from row to row"):
        model.predict(np.array([[K]]), T[::-1])
    with pytest.raises(ValueError, match="expected rows at two different times"):
        model.predict(np.array([[K]]), T[:1])


def test_without_the_library_it_says_how_to_get_it(
    fmu: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(ImportError, match=r"missing \(fmpy\); pip install 'miho\[fmu\]'"):
        FmuModel(fmu(CO_SIMULATION), ["k"], ["x"])
