"""Measured and simulated loops: records, data sets, and reading them from files."""

from hystfit.data.read import read as read
from hystfit.data.read import read_csv as read_csv
from hystfit.data.record import Dataset as Dataset
from hystfit.data.record import Record as Record
