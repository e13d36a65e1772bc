"""From a configuration to a drive: the car as it is known, the road, the driver, the laps."""
