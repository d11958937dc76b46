"""Quantities of a loop from its samples, by their IEC names: coercivity, remanence, loss and others.

Enters: a `Record`.
Leaves: values with errors and units.
Open first: `loop_values.py`.
"""
