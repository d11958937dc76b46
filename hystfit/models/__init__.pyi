"""The names of this room and their modules: the only list, read by `__init__.py` and by type checkers."""

from .base import AbstractHysteresis as AbstractHysteresis
from .bouc_wen import BoucWen as BoucWen
from .bouc_wen_asymmetric import AsymmetricBoucWen as AsymmetricBoucWen
from .bouc_wen_force import BoucWenForce as BoucWenForce
from .creep import LinearCreep as LinearCreep
from .creep import LogCreep as LogCreep
from .duhem import Duhem as Duhem
from .dynamics import Delay as Delay
from .dynamics import Lag as Lag
from .dynamics import SecondOrder as SecondOrder
from .jiles_atherton import JilesAtherton as JilesAtherton
from .negate import Negate as Negate
from .offset import Offset as Offset
from .oscillator import BoucWenOscillator as BoucWenOscillator
from .prandtl_ishlinskii import PrandtlIshlinskii as PrandtlIshlinskii
from .preisach.model import Preisach as Preisach
from .preisach.parametric import ParametricPreisach as ParametricPreisach
from .preisach.signed import SignedPreisach as SignedPreisach
from .preisach.tabulated import TabulatedPreisach as TabulatedPreisach
from .rate import SaturatingRate as SaturatingRate
from .rate import Viscous as Viscous
from .relaxation import Relaxation as Relaxation
from .series import Series as Series
from .simulation import Resume as Resume
from .simulation import simulate as simulate
from .sum import Sum as Sum
