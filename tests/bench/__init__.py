"""Figures of speed, measured in one run by `make bench`. Machines differ and are shared: compare in a run."""
