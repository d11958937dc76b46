"""Excitations that reveal hysteresis: numpy functions of time, and their registry.

Limits `low` and `high` are in the unit of the input, `rate` in samples/s and times in seconds. Every function returns
`(t, u)`, both of shape (T,); `forc_protocol` has no time and returns `(u, curve)`.
"""

from hystfit.signals.registry import SIGNALS as SIGNALS
from hystfit.signals.registry import Signal as Signal
from hystfit.signals.registry import make as make
from hystfit.signals.registry import signal as signal
from hystfit.signals.turning_points import amplitude_sweep as amplitude_sweep
from hystfit.signals.turning_points import forc_protocol as forc_protocol
from hystfit.signals.turning_points import random_reversals as random_reversals
from hystfit.signals.turning_points import staircase as staircase
from hystfit.signals.turning_points import step as step
from hystfit.signals.waves import chirp as chirp
from hystfit.signals.waves import crest_factor as crest_factor
from hystfit.signals.waves import decaying_sine as decaying_sine
from hystfit.signals.waves import multisine as multisine
from hystfit.signals.waves import sine as sine
from hystfit.signals.waves import triangle as triangle
