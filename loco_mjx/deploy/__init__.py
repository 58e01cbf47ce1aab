"""Running a policy outside of the simulator it was trained in; only `export.py` imports JAX."""
