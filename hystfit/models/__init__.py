"""Hysteresis models, one file each: a new model is one file and one line in `__init__.pyi`; each is imported when it is first used.

Enters: parameters in physical units, a state, and two successive inputs with the time between them.
Leaves: the next state and the output; starting values, closed-form columns, an inverse and C code where a model has them.
Open first: `base.py`, then a short model, such as `bouc_wen.py`; `entries.py` has their names.
"""

from hystfit.lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__)
