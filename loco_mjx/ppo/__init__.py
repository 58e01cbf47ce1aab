"""Proximal policy optimisation as pure functions, and the program that runs them over a mesh of devices."""
