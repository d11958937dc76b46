"""Parameters: declared on the fields of a model, collected by name into vectors.

Enters: fields made by `hf.param`, with bounds, units and scales.
Leaves: a `ParameterSpace` (names and units, on the host) and its `coordinates` (maps to unconstrained vectors, traced).
Open first: `param.py`, then `space.py`.
"""

from hystfit.params.param import ParamInfo as ParamInfo
from hystfit.params.param import param as param
from hystfit.params.space import ParameterSpace as ParameterSpace
