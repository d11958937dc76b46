"""Measured and simulated loops on the host, and as arrays for compiled code.

Enters: arrays of input, output and time with their units and names.
Leaves: a `Record`, several as a `Dataset`, and the padded arrays of a `Batch`.
Open first: `record.py`.
"""

from hystfit.data.dataset import Dataset as Dataset
from hystfit.data.record import Record as Record
