"""Inverses, feedback, loops and C code for what was fitted.

Enters: a fit (`FitResult`) or a model, and what its output should follow.
Leaves: the input that makes it so, with a status for each sample; controllers with margins; C99 code and lines for OpenSees.
Open first: `inverse.py`.
"""

from hystfit.control.export import export_c as export_c
from hystfit.control.feedback import AbstractController as AbstractController
from hystfit.control.feedback import Controller as Controller
from hystfit.control.feedback import Design as Design
from hystfit.control.feedback import assess as assess
from hystfit.control.feedback import design as design
from hystfit.control.feedback import pd_lead_lag as pd_lead_lag
from hystfit.control.field_programs import export_field_programs as export_field_programs
from hystfit.control.inverse import Inverse as Inverse
from hystfit.control.inverse import invert as invert
from hystfit.control.inverse import lead as lead
from hystfit.control.loop import LoopResult as LoopResult
from hystfit.control.loop import run_loop as run_loop
from hystfit.control.online_inverse import AbstractRunningInverse as AbstractRunningInverse
from hystfit.control.online_inverse import InverseStep as InverseStep
from hystfit.control.online_inverse import Status as Status
from hystfit.control.opensees import export_opensees as export_opensees
from hystfit.control.plant import LinearPlant as LinearPlant
from hystfit.control.plant import identify_plant as identify_plant
from hystfit.control.transfer import Margins as Margins
from hystfit.control.transfer import TransferFunction as TransferFunction
from hystfit.control.transfer import margins as margins
from hystfit.control.transfer import root_locus as root_locus
from hystfit.control.transfer import second_order as second_order
