"""Populations: how much devices of one kind differ, and what the next one will do.

Enters: loops of many devices (`batch` reads and fits them), with the name of a model.
Leaves: a `PopulationFit`: mean device, scatter and correlations with intervals, better values of each device, the next device.
Open first: `fit_population.py`, then `hierarchy.py`, the second stage.
"""
