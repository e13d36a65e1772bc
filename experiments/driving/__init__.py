"""From a configuration to a drive: the known car, the road, the driver, the laps."""
