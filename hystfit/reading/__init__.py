"""Reading measured loops from files, and data sets by name."""

from hystfit.reading import datasets as datasets
from hystfit.reading.read import read as read
from hystfit.reading.read import read_csv as read_csv
