"""Models of tires, axles, brakes, engines and the motion of a car."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.vehicle.models.axle import Axle, central_stiffness, cornering_stiffness
    from miho.vehicle.models.brake import Brake, BrakeCommand
    from miho.vehicle.models.brake_dynamics import BrakePlay, BrakeResponse, play
    from miho.vehicle.models.brake_statics import BrakeDeceleration, BrakePressure, BrakeTorque
    from miho.vehicle.models.engine import TorqueCubic, TorqueCurve
    from miho.vehicle.models.engine_map import EngineMap
    from miho.vehicle.models.lateral_magic_formula import LateralMagicFormula, mf61_lateral
    from miho.vehicle.models.load_scaling import LoadSensitivity, at_load, load_sensitivity
    from miho.vehicle.models.longitudinal import Longitudinal
    from miho.vehicle.models.simplified_tire import SimplifiedTire, from_simplified, simplify
    from miho.vehicle.models.single_track import FrontRear, SingleTrack
    from miho.vehicle.models.single_track_motion import single_track_drive, single_track_response
    from miho.vehicle.models.tir import load_tir, write_tir
    from miho.vehicle.models.tir_reader import TirError
    from miho.vehicle.models.tire import Pacejka, PacejkaCurvature, PacejkaLandmarks
    from miho.vehicle.models.tire_formula import TireFormula

__all__ = [
    "Axle", "Brake", "BrakeCommand", "BrakeDeceleration", "BrakePlay", "BrakePressure",
    "BrakeResponse", "BrakeTorque", "EngineMap", "FrontRear", "LateralMagicFormula",
    "LoadSensitivity", "Longitudinal", "Pacejka", "PacejkaCurvature", "PacejkaLandmarks",
    "SimplifiedTire", "SingleTrack", "TirError", "TireFormula", "TorqueCubic", "TorqueCurve",
    "at_load", "central_stiffness", "cornering_stiffness", "from_simplified", "load_sensitivity",
    "load_tir", "mf61_lateral", "play", "simplify", "single_track_drive", "single_track_response",
    "write_tir",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
