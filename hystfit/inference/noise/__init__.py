"""What a model leaves of a measurement, as a random process: the likelihoods of `fit`, `sample` and `calibrate`."""

from hystfit.inference.noise.base import AbstractNoise as AbstractNoise
from hystfit.inference.noise.independent import StudentT as StudentT
from hystfit.inference.noise.independent import White as White
from hystfit.inference.noise.repeating import LoopDiscrepancy as LoopDiscrepancy
from hystfit.inference.noise.repeating import inducing_shapes as inducing_shapes
from hystfit.inference.noise.setting import Setting as Setting
from hystfit.inference.noise.slow import AbstractSlow as AbstractSlow
from hystfit.inference.noise.slow import Ar1 as Ar1
from hystfit.inference.noise.slow import OrnsteinUhlenbeck as OrnsteinUhlenbeck
from hystfit.inference.noise.starting import NOISES as NOISES
from hystfit.inference.noise.starting import make_noise as make_noise
from hystfit.inference.noise.starting import starting_noise as starting_noise
