"""What models share: simulation, starting values, design matrices, inverses of one step, C code.

Enters: a model and inputs.
Leaves: outputs, their derivatives, columns of linear weights.
Open first: `simulation.py`.
"""
