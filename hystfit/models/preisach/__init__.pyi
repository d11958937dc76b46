"""The public names and their modules, read by `__init__.py` and by type checkers."""

from .everett_table import EverettTable as EverettTable
from .forc_diagram import forc_diagram as forc_diagram
from .properties import congruency as congruency
from .properties import error_by_order as error_by_order
from .properties import wiping_out as wiping_out
from .suitability import check_family as check_family
from .suitability import check_preisach as check_preisach
from .suitability import higher_order as higher_order
