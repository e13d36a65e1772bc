"""Former names, with the present ones for the error of an import (`miho.exports`)."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

LIGHT_METHODS = (
    "cluster_gauss_newton", "differential_evolution", "dual_annealing", "gbo", "hickernell_yuan",
    "hyperband", "least_squares", "local_search", "pso", "scatter_search", "tiktak",
    "variable_projection",
)  # fmt: skip
"""Former modules of `baselines`, whose methods are in `miho.methods`."""
MOVED = {
    **{f"baselines.{module}": "miho.methods" for module in LIGHT_METHODS},
    "miho.driving": "miho.vehicle.driving",
    "miho.compiled.climb": "miho.compiled.taped",
    "miho.compiled.workspace": "miho.compiled.gauss_newton",
    "miho.optim.mutation": "miho.optim.miho",
    "miho.data.units": "miho.units",
    "miho.vehicle.data.synthetic_play": "miho.vehicle.data.synthetic_brake",
    "miho.vehicle.driving.inverse_powertrain": "miho.vehicle.driving.speed_control",
    "miho.vehicle.driving.sensors": "miho.vehicle.driving.plant",
    "miho.vehicle.driving.centre_line": "miho.vehicle.driving.lines",
    "miho.vehicle.driving.velocity_as_printed": "miho.vehicle.driving.as_printed",
    "miho.vehicle.driving.steering_as_printed": "miho.vehicle.driving.as_printed",
    "miho.vehicle.driving.multi_body": "tests.vehicle.driving.multi_body",
    "miho.vehicle.driving.MultiBody": "tests.vehicle.driving.multi_body.MultiBody",
    "miho.vehicle.models.tire_fit": "miho.vehicle.models.tire_formula",
    "miho.analysis.arena_results": "baselines.arena.results",
    "miho.analysis.compare.readings": "baselines.arena.readings",
    "miho.identification.statement": "miho.identification.conclusion",
    "miho.analysis.generalisation": "experiments.app.front_axle",
    "miho.parallel.cluster_workers": "experiments.app.cluster_workers",
    "miho.study.closure": "experiments.app.closure",
    "miho.study.meaning": "experiments.app.meaning",
    "miho.vehicle.driving.outcome": "experiments.driving.outcome",
    "miho.vehicle.driving.tracked_friction": "experiments.driving.falling_grip",
    "miho.study.curves": "miho.study.index",
    "miho.study.scan": "miho.study.index",
    "miho.analysis.figures.arena": "baselines.arena.figures",
    "miho.analysis.figures.ranking": "baselines.arena.ranking",
    "miho.analysis.figures.readings": "baselines.arena.readings",
    "miho.data.published_fits": "baselines.problems",
    "miho.models.published": "baselines.problems",
    "miho.data.PublishedFit": "baselines.problems.PublishedFit",
    "miho.data.load_published": "baselines.problems.load_published",
    "miho.data.published_fit": "baselines.problems.published_fit",
    "miho.data.published_names": "baselines.problems.published_names",
    "miho.data.zero_residuals": "baselines.problems.zero_residuals",
    "miho.models.PublishedModel": "baselines.problems.PublishedModel",
    "miho.models.ResidualSystem": "baselines.problems.ResidualSystem",
}
"""Present dotted names of modules and public names, by former ones."""
PARTS_OF_ORACLE = {
    "ahead": "workers.ahead",
    "first_ready": "workers.first_ready",
    "spreads": "workers.spreads",
    "usage": "workers.usage",
    "busy": "workers.busy",
    "descent": "starts.descent",
    "record_descent": "starts.add",
    "record_dropped": "starts.dropped += 1",
    "record_screened": "starts.screened += n",
    "agreement": "starts.agreement(oracle.best)",
    "remaining_seconds": "budget.seconds - oracle.seconds",
} | {
    name: f"traits.{name}"
    for name in (
        "cost", "jacobian_cost", "kernel", "linear", "noise", "order", "resolution", "rounding",
        "rows",
    )
}  # fmt: skip
"""Present places of members of an oracle, by former names."""
SETTINGS = {
    "rows": "rows_per_parameter",
    "jump": "full_data_share",
    "enough": "max_rows_per_parameter",
    "base": "base_cost",
    "largest": "max_cost",
    "least": "min_candidates",
    "most": "max_candidates",
    "steps": "steps_per_rung",
    "lead": "leader_steps",
    "fading": "scale_decay",
    "reach": "max_step",
    "radius": "max_step",
    "secants": "max_secants",
    "guesses": "max_predicted_steps",
    "refresh": "hessian_interval",
    "projecting": "projection_period",
    "edge": "simplex_edge",
    "polish": "simplex_budget",
    "digits": "final_tolerance",
    "progress": "min_progress",
    "doubtful": "doubtful_brackets",
    "longer": "doubtful_cost",
    "brackets": "max_brackets",
}
"""Present names of the settings of METHODS, by former ones."""
METHODS = ("MIHOGN", "AsynchronousMIHOGN", "MIHOQN")
PACKAGES = {
    "miho.data": "miho.vehicle.data",
    "miho.models": "miho.vehicle.models",
    **{f"baselines.{module}": "miho.methods" for module in LIGHT_METHODS},
}
"""Packages of which some names and modules moved to another package."""


def new_name(name: str) -> str | None:
    """Return the present dotted name of a former module or public name, None for other names."""
    package, _, member = name.rpartition(".")
    if name not in MOVED and package in PACKAGES:
        home = PACKAGES[package]
        if member in import_module(home).__all__ or find_spec(f"{home}.{member}"):
            return f"{home}.{member}"
    return MOVED.get(name)


def with_present_names(config: Any) -> Any:
    """Return a stored configuration with the present names of targets and settings."""
    if isinstance(config, dict):
        target = config.get("_target_")
        settings = SETTINGS if str(target).rpartition(".")[2] in METHODS else {}
        return {
            settings.get(key, key): new_name(value) or value
            if key == "_target_" and isinstance(value, str)
            else with_present_names(value)
            for key, value in config.items()
        }
    return [with_present_names(value) for value in config] if isinstance(config, list) else config
