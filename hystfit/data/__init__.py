"""Measured and simulated loops on the host, and as arrays for compiled code."""

from hystfit.data.dataset import Dataset as Dataset
from hystfit.data.record import Record as Record
