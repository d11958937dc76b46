"""What a model leaves of a measurement, as a random process: the likelihoods of `fit`, `sample` and `calibrate`."""

from hystfit.noise.base import AbstractNoise as AbstractNoise
from hystfit.noise.independent import StudentT as StudentT
from hystfit.noise.independent import White as White
from hystfit.noise.repeating import LoopDiscrepancy as LoopDiscrepancy
from hystfit.noise.repeating import inducing_shapes as inducing_shapes
from hystfit.noise.setting import Setting as Setting
from hystfit.noise.slow import AbstractSlow as AbstractSlow
from hystfit.noise.slow import Ar1 as Ar1
from hystfit.noise.slow import OrnsteinUhlenbeck as OrnsteinUhlenbeck
from hystfit.noise.starting import NOISES as NOISES
from hystfit.noise.starting import make_noise as make_noise
from hystfit.noise.starting import starting_noise as starting_noise
