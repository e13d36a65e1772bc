"""Drive what was identified: the car, its plant, planning and control."""
