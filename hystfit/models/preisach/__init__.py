"""The Preisach model from reversal curves: tables, densities, and the properties that the model presumes of a material."""

from hystfit.models.preisach.everett_table import EverettTable as EverettTable
from hystfit.models.preisach.forc import fit_forc as fit_forc
from hystfit.models.preisach.forc_diagram import forc_diagram as forc_diagram
from hystfit.models.preisach.properties import congruency as congruency
from hystfit.models.preisach.properties import error_by_order as error_by_order
from hystfit.models.preisach.properties import wiping_out as wiping_out
from hystfit.models.preisach.suitability import check_family as check_family
from hystfit.models.preisach.suitability import check_preisach as check_preisach
from hystfit.models.preisach.suitability import higher_order as higher_order
