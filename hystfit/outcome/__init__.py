"""The typed words of every verb: its status, its notes and its tables.

Enters: facts found by other rooms.
Leaves: `Status`, `Note(code, severity, text)` and `Table`, which print, save and show in notebooks.
Open first: `note.py`.
"""

from hystfit.outcome.note import Code as Code
from hystfit.outcome.note import Note as Note
from hystfit.outcome.note import Severity as Severity
from hystfit.outcome.notebook import fragment as fragment
from hystfit.outcome.status import Status as Status
from hystfit.outcome.status import WithStatus as WithStatus
from hystfit.outcome.table import Column as Column
from hystfit.outcome.table import Table as Table
