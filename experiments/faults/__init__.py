"""What training, the command line and a robot's runner survive: ``python -m experiments.faults``."""
