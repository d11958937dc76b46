"""Reading measured loops from files, and data sets by name.

Enters: a path, bytes, or a data frame.
Leaves: a `Dataset` with units, what the instrument stated, and notes on what was left out.
Open first: `read.py`; `registry.py` lists the layouts of text, `choice/` finds input and output.
"""

from hystfit.reading import datasets as datasets
from hystfit.reading.read import read as read
from hystfit.reading.read import read_csv as read_csv
