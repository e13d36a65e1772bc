"""Parametric models: pure functions of inputs and a batch of parameters."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.models.axle import Axle, central_stiffness, cornering_stiffness
    from miho.models.brake import Brake, BrakeCommand
    from miho.models.brake_dynamics import BrakeResponse, play
    from miho.models.brake_play import BrakePlay
    from miho.models.brake_statics import BrakeDeceleration, BrakePressure, BrakeTorque
    from miho.models.engine import TorqueCubic, TorqueCurve
    from miho.models.engine_map import EngineMap
    from miho.models.fmu import FmuModel
    from miho.models.function_model import FunctionModel
    from miho.models.identified import Identified, OutsideDataWarning, read_parameters
    from miho.models.lateral_magic_formula import LateralMagicFormula, mf61_lateral
    from miho.models.load_scaling import LoadSensitivity, at_load, load_sensitivity
    from miho.models.longitudinal import Longitudinal
    from miho.models.model import Model
    from miho.models.published import PublishedModel
    from miho.models.published.systems import ResidualSystem
    from miho.models.simplified_tire import SimplifiedTire, from_simplified, simplify
    from miho.models.single_track import FrontRear, SingleTrack
    from miho.models.single_track_motion import single_track_drive, single_track_response
    from miho.models.tir import load_tir, write_tir
    from miho.models.tir_reader import TirError
    from miho.models.tire import Pacejka, PacejkaCurvature
    from miho.models.tire_formula import TireFormula
    from miho.models.tire_landmarks import PacejkaLandmarks
    from miho.models.trajectory import Trajectory
    from miho.models.user_file import load_function, load_trajectory

__all__ = [
    "Axle", "Brake", "BrakeCommand", "BrakeDeceleration", "BrakePlay", "BrakePressure",
    "BrakeResponse", "BrakeTorque", "EngineMap", "FmuModel", "FrontRear", "FunctionModel",
    "Identified", "LateralMagicFormula", "LoadSensitivity", "Longitudinal", "Model",
    "OutsideDataWarning", "Pacejka", "PacejkaCurvature", "PacejkaLandmarks", "PublishedModel",
    "ResidualSystem", "SimplifiedTire", "SingleTrack", "TirError", "TireFormula", "TorqueCubic",
    "TorqueCurve", "Trajectory", "at_load", "central_stiffness", "cornering_stiffness",
    "from_simplified", "load_function", "load_sensitivity", "load_tir", "load_trajectory",
    "mf61_lateral", "play", "read_parameters", "simplify", "single_track_drive",
    "single_track_response", "write_tir",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
