"""Points of physical quantities as the input and the output of a device, and of pairs of them that belong together.

Points are like logarithms of odds, as in `hystfit.reading.choice.pair_score`.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping

# Points of a quantity as the input and as the output of a device.
DRIVE = {
    "state of charge": 3.0, "voltage": 2.5, "field": 2.5, "electric field": 2.5, "current": 2.0, "pressure": 1.8,
    "strain": 1.7, "displacement": 1.4, "induction": 2.2, "shear rate": 1.2, "flow": 0.8, "": 0.8, "mass": 0.8, "volume": 1.0,
    "diameter": 0.8, "concentration": 0.8, "radiation": 0.8,
    "phase": -3.5, "temperature": -1.0, "resistance": -1.0, "force": -1.0, "stress": -1.0,
}  # fmt: skip
RESPONSE = {
    "moment": 2.5, "magnetization": 2.5, "induction": 2.5, "polarization": 2.5, "charge": 2.3, "piezoresponse": 2.5, "force": 2.0,
    "stress": 2.0, "displacement": 1.8, "strain": 1.6, "voltage": 0.8, "": 0.8, "current": 0.6,
    "current density": 0.6, "resistance": 0.3, "temperature": -1.0,
    "stiffness": 1.5,  # force per length: the shear of a wall, the reaction of soil on a pile
    "loading": 2.5, "mass": 1.5, "wavelength": 2.0, "flux": 2.5, "capacitance": 1.5, "inductance": 1.0, "pressure": 0.3, "flow": 0.8,
    "volume": 0.8, "diameter": 1.8, "concentration": 1.8, "state": 0.8, "heat flow": 1.5,
}  # fmt: skip
SELDOM = -4.0  # of a rate, a frequency, a flag: never the input or output where there is another column
LOADS = ("force", "stress")
_MAGNETIC, _SENSED = ("moment", "magnetization", "induction", "flux"), ("wavelength", "capacitance", "inductance")
# Points of pairs that belong together, besides those of each column.
PAIRS: Mapping[tuple[str, str], float] = (
    dict.fromkeys(itertools.product(["field"], _MAGNETIC), 4.0)
    | dict.fromkeys([("electric field", "polarization"), ("voltage", "polarization"), ("voltage", "charge")], 4.0)
    | {("pressure", "loading"): 4.0, ("pressure", "mass"): 4.0, ("voltage", "piezoresponse"): 4.0, ("state of charge", "voltage"): 4.0}
    | {("flow", "concentration"): 4.0}  # of a river
    | {("displacement", "force"): 4.0, ("displacement", "stiffness"): 4.0}
    | {("strain", "stress"): 4.0, ("shear rate", "stress"): 4.0}
    | dict.fromkeys(
        [
            ("voltage", "displacement"), ("electric field", "strain"), ("voltage", "strain"),
            ("current", "displacement"), ("current", "induction"), ("current", "flux"), ("induction", "moment"), ("pressure", "diameter"),
            ("induction", "magnetization"), ("pressure", "displacement"), ("current", "force"),
            *itertools.product(["field", "induction"], ["displacement", "strain", ""]), ("field", "voltage"),
            ("displacement", "moment"), ("volume", "stress"),
        ],
        3.0,
    )
    # A voltage and a force are worth less than a displacement and its force beside a gauge in volts.
    | {("voltage", "force"): 1.0, ("induction", "voltage"): 1.5, ("strain", "force"): 3.0, ("displacement", "stress"): 2.5}
    | dict.fromkeys(itertools.product(["temperature"], [*_MAGNETIC, *LOADS, "displacement", "strain", "current", "state", ""]), 3.0)
    | dict.fromkeys(  # sensors, and converters of a current to a pressure
        [
            *itertools.product(["force", "stress", "pressure", "temperature"], [*_SENSED, "resistance"]),
            *itertools.product(["strain", "displacement"], _SENSED), ("current", "pressure"), ("displacement", "flow"),
        ],
        3.0,
    )
    | dict.fromkeys([("strain", "resistance"), ("displacement", "resistance")], 1.0)  # less than beside a temperature that drives both
    | {("temperature", "heat flow"): 4.0, ("induction", "resistance"): 3.0, ("pressure", "flow"): 1.5, ("pressure", "volume"): 2.5}
    | {("displacement", "concentration"): -2.0, ("concentration", "displacement"): -2.0}  # the depth to which water is clear
    | {("volume", "displacement"): 1.0, ("force", ""): 0.5}  # of a drop or a syringe; of a sensor under a load
    | {("field", "resistance"): 3.0, ("current", "field"): 6.0}  # of a coil, where nothing else responds to its field
    | dict.fromkeys([("voltage", "current"), ("current", "voltage")], 0.5)
    | dict.fromkeys([("voltage", "current density"), ("electric field", "current density")], 0.5)
)  # fmt: skip
