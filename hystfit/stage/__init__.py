"""The simulated stage: piezo actuators, their amplifiers and sensors, and the mechanism that they move.

Enters: an input signal, or a controller.
Leaves: records to train on, and a plant to control.
Open first: `actuator.py`, then `stage.py`.
"""

from hystfit.stage.actuator import Actuator as Actuator
from hystfit.stage.actuator import Amplifier as Amplifier
from hystfit.stage.actuator import Sensor as Sensor
from hystfit.stage.actuator import perturbed as perturbed
from hystfit.stage.actuator import piezo as piezo
from hystfit.stage.adaptive import AdaptiveTracking as AdaptiveTracking
from hystfit.stage.adaptive import track_adaptively as track_adaptively
from hystfit.stage.decoupled import Decoupled as Decoupled
from hystfit.stage.decoupled import StageInverse as StageInverse
from hystfit.stage.kinematics import JacobianEstimate as JacobianEstimate
from hystfit.stage.kinematics import Kinematics as Kinematics
from hystfit.stage.kinematics import drive_in_turn as drive_in_turn
from hystfit.stage.kinematics import identify_jacobian as identify_jacobian
from hystfit.stage.population import Population as Population
from hystfit.stage.population import population as population
from hystfit.stage.stage import Stage as Stage
from hystfit.stage.stage import StageMeasurement as StageMeasurement
from hystfit.stage.stage import axis_plant as axis_plant
from hystfit.stage.stage import upsample as upsample
