"""Simulation of an identified car: vehicle, plants, planning and control."""

from typing import TYPE_CHECKING

from miho.exports import at_first_use

if TYPE_CHECKING:
    from miho.driving.double_track import DoubleTrack
    from miho.driving.driver import Driver
    from miho.driving.embedded import embedded_plant
    from miho.driving.known_car import KnownCar
    from miho.driving.load_transfer import LoadTransfer, WheelLoads
    from miho.driving.multi_body import MultiBody
    from miho.driving.ovals import ims, lvms
    from miho.driving.plant import Command, Motion, Plant
    from miho.driving.road import PLANE, Road, road_of
    from miho.driving.sensors import Sensors
    from miho.driving.simulation import Drive, simulate
    from miho.driving.track import Track
    from miho.driving.vehicle import Vehicle
    from miho.driving.velocity_planner import VelocityPlanner

__all__ = [
    "PLANE", "Command", "DoubleTrack", "Drive", "Driver", "KnownCar", "LoadTransfer", "Motion",
    "MultiBody", "Plant", "Road", "Sensors", "Track", "Vehicle", "VelocityPlanner", "WheelLoads",
    "embedded_plant", "ims", "lvms", "road_of", "simulate",
]  # fmt: skip

__getattr__, __dir__ = at_first_use(__name__)
