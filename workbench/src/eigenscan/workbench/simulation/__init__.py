"""A robot with a lidar in a building, simulated: seeded, deterministic, in simulated time."""
