"""Lower bound of the makespan over all choices of robots, objects, grips and supports."""
