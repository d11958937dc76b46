"""The Preisach model from reversal curves: tables, densities, and the properties that the model presumes of a material."""

from hystfit.preisach.forc import fit_forc as fit_forc
from hystfit.preisach.forc import forc_diagram as forc_diagram
from hystfit.preisach.forc import predict_curves as predict_curves
from hystfit.preisach.judge import check_preisach as check_preisach
from hystfit.preisach.judge import higher_order as higher_order
from hystfit.preisach.properties import congruency as congruency
from hystfit.preisach.properties import error_by_order as error_by_order
from hystfit.preisach.properties import wiping_out as wiping_out
from hystfit.preisach.table import EverettTable as EverettTable
