"""Hysteresis models, one file each: a new model is one file and one line here."""

from hystfit.models.base import AbstractHysteresis as AbstractHysteresis
from hystfit.models.base import Resume as Resume
from hystfit.models.base import simulate as simulate
from hystfit.models.bouc_wen import BoucWen as BoucWen
from hystfit.models.bouc_wen_asymmetric import AsymmetricBoucWen as AsymmetricBoucWen
from hystfit.models.bouc_wen_force import BoucWenForce as BoucWenForce
from hystfit.models.compose import Offset as Offset
from hystfit.models.compose import Series as Series
from hystfit.models.compose import Sum as Sum
from hystfit.models.creep import LinearCreep as LinearCreep
from hystfit.models.creep import LogCreep as LogCreep
from hystfit.models.duhem import Duhem as Duhem
from hystfit.models.dynamics import Delay as Delay
from hystfit.models.dynamics import Lag as Lag
from hystfit.models.dynamics import SecondOrder as SecondOrder
from hystfit.models.oscillator import BoucWenOscillator as BoucWenOscillator
from hystfit.models.prandtl_ishlinskii import PrandtlIshlinskii as PrandtlIshlinskii
from hystfit.models.preisach.model import Preisach as Preisach
from hystfit.models.preisach.parametric import ParametricPreisach as ParametricPreisach
from hystfit.models.preisach.signed import SignedPreisach as SignedPreisach
from hystfit.models.preisach.tabulated import TabulatedPreisach as TabulatedPreisach
from hystfit.models.rate import SaturatingRate as SaturatingRate
from hystfit.models.rate import Viscous as Viscous
from hystfit.models.relaxation import Relaxation as Relaxation
