"""Motions that show the parameters of a robot: trajectories within its limits, and what they will tell."""
