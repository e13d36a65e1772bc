"""Simulation of an identified car: vehicle, plants, planning and control."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.vehicle.driving.double_track import DoubleTrack, FrictionSchedule
    from miho.vehicle.driving.driver import Driver
    from miho.vehicle.driving.embedded import embedded_plant
    from miho.vehicle.driving.known_car import KnownCar
    from miho.vehicle.driving.learning_driver import FrictionSource, LearningDriver
    from miho.vehicle.driving.load_transfer import LoadTransfer, WheelLoads
    from miho.vehicle.driving.ovals import ims, lvms
    from miho.vehicle.driving.plant import Command, Motion, Plant, Sensors
    from miho.vehicle.driving.road import PLANE, Road, road_of
    from miho.vehicle.driving.simulation import Drive, simulate
    from miho.vehicle.driving.track import Track
    from miho.vehicle.driving.vehicle import Vehicle
    from miho.vehicle.driving.velocity_planner import VelocityPlanner

__all__ = [
    "PLANE", "Command", "DoubleTrack", "Drive", "Driver", "FrictionSchedule", "FrictionSource",
    "KnownCar", "LearningDriver", "LoadTransfer", "Motion", "Plant", "Road", "Sensors", "Track",
    "Vehicle", "VelocityPlanner", "WheelLoads",
    "embedded_plant", "ims", "lvms", "road_of", "simulate",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
