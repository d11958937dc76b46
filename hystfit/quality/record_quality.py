"""Measured values of one record for the data-quality report, and the properties that follow from them."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping

from hystfit.data.circulation import FOLLOWS, OF_RATE
from hystfit.params.units import quantity
from hystfit.quality.delay import SHORTEST, PureDelay
from hystfit.quality.drift import Drift
from hystfit.quality.faults import CLEAR
from hystfit.quality.lag import Lag
from hystfit.quality.loops import APART
from hystfit.quality.resonance import Dynamics
from hystfit.quality.shape import Shape

LONG_HOLD = 50  # samples of a hold in which creep would show
SOFTER = 0.7  # part of the first stiffness after a reversal below which the later one shows damage
WHOLE = 1 - APART  # part of the stiffness from which a device is whole
# Part of the stiffness or of the output that is left on late branches, or after larger strokes, below which it shows damage.
WEAKER = 0.88
# Pairs of which the output may be the rate of a charge, a flux or an enthalpy, and the part of its size from which it is that of a flux
# with the other sign: the voltage of a sensor that lags behind a field has -0.8 where the coercivity is 0.8 of the largest field.
OF_CHARGE = frozenset(itertools.product(("voltage", "electric field"), ("current", "current density")))
_OF_FLUX = frozenset({("current", "voltage"), ("field", "voltage")})
OF_ENTHALPY = frozenset({("temperature", "heat flow"), ("temperature", "power")})  # as of calorimeters
_WIDEST = 0.9
# Quantities that do work on a device and those which they drive: a device that dissipates it lags, counter-clockwise.
_WORK = frozenset(
    {
        *itertools.product(("field", "induction"), ("moment", "magnetization")),
        *itertools.product(("voltage", "electric field"), ("charge", "polarization", "state of charge")),
        *(("field", "induction"), ("current", "flux"), ("force", "displacement"), ("stress", "strain")),
    }
)


@dataclasses.dataclass(frozen=True)
class Sampling:
    """Samples and time: `rate` [samples per unit of time], `uniform` (steps within 1 %), `gaps` (over 1.5 steps)."""

    n: int
    missing: int
    left_out: int
    duration: float | None
    rate: float | None
    uniform: bool | None
    repeated_stamps: int
    gaps: int

    @property
    def used(self) -> int:
        """Number of samples that count; at least that where missing samples are also left out."""
        return max(self.n - self.missing - self.left_out, 0)


@dataclasses.dataclass(frozen=True)
class Column:
    """Extent and noise of one column, in its unit.

    Attributes:
        noise_is_bound: the noise is an upper bound only.
        decades: over which the upper three quarters of the sizes extend, of a column of one sign; 0 of others.
    """

    low: float
    high: float
    resolution: float | None
    noise_rms: float | None
    noise_is_bound: bool
    decades: float = 0.0

    @property
    def range(self) -> float:
        """Largest minus smallest value."""
        return self.high - self.low

    @property
    def known_noise(self) -> float | None:
        """RMS noise where it is an estimate and not only a bound."""
        return None if self.noise_is_bound else self.noise_rms


@dataclasses.dataclass(frozen=True)
class Motion:
    """Motion of the input.

    Attributes:
        threshold: change of u by which a turning point must stand out [unit of u].
        reversals: number of turning points.
        chatter_percent: share of the samples at which the input steps back against its branch.
        smoothing: length of the smoothing filter that removes the chatter [samples]; None if none is needed or helps.
        closed_loops, major, minor, nested: loops that close; those within 5 % of the largest stroke; the others; those inside
            another.
        cycles: pairs of branches, closed or not.
        strokes: different strokes, largest first, as fractions of the input's range (5 % apart).
        turning_pairs: different (low, high) pairs of neighboring turning levels (5 % of the range apart).
        monotonic: the input never turns.
        holds, longest_hold, hold_creep: holds of the input, the longest [samples], and the largest change of the output during
            one as a fraction of its range.
        speeds: different speeds of the branches, decimal logarithm of units of u over units of t, fastest first (a factor of 3 apart).
    """

    threshold: float
    reversals: int
    chatter_percent: float
    smoothing: int | None
    closed_loops: int
    major: int
    minor: int
    nested: int
    cycles: int
    strokes: tuple[float, ...]
    turning_pairs: int
    monotonic: bool
    holds: int
    longest_hold: int
    hold_creep: float | None
    speeds: tuple[float, ...] = ()


@dataclasses.dataclass(frozen=True)
class RecordQuality:
    """Everything measured on one record; None where it is unknown.

    Attributes:
        slow_lag: of the output, where it is longer than the turns of the loops show [samples].
        delay: of the output; all other properties are measured with the input delayed by it.
        area: signed, of the whole record, see `loops.loop_area`.
        correlation: of output and input, see `circulation.trend`.
        of_rate: of the output, see `circulation.of_rate`.
        output_controlled: whether the test controlled the output, see `load_control`.
        flat_ends: samples at level ends of the loop, see `flat_ends`.
        whole_until, fails_at: see `damage`, where the record is examined by itself.
    """

    name: str
    units: dict[str, str]
    sampling: Sampling
    u: Column
    y: Column
    motion: Motion
    shape: Shape | None
    area: float
    correlation: float
    drift: Drift | None
    lag: Lag | None
    rate_effect: float | None
    stiffness_left: float | None
    strength_left: float | None
    unloading_left: float | None
    softening_left: float | None
    dynamics: Dynamics | None
    clipped: int
    spikes: int
    slow_lag: float | None = None
    delay: PureDelay | None = None
    of_rate: float = 0.0
    flat_ends: int = 0
    output_controlled: bool = False
    whole_until: float | None = None
    fails_at: float | None = None

    @property
    def is_rate(self) -> bool:
        """Whether the output is the rate of what makes the loop: a charging current, an induced voltage, a heat flow."""
        return is_rate(self.units, self.of_rate)

    @property
    def dynamic(self) -> bool:
        """Whether the response changes with frequency as that of an oscillator does, beyond a lag or a velocity term."""
        return self.dynamics is not None and self.dynamics.resonant

    @property
    def falls(self) -> bool:
        """Whether the output falls as the input rises, apart from the loop."""
        return self.correlation < -FOLLOWS

    @property
    def circulation(self) -> str | None:
        """Direction of the loop, of the mirrored one where the output falls; None where no loop is open."""
        way = None if self.shape is None else self.shape.circulation
        opposite = {"clockwise": "counter-clockwise", "counter-clockwise": "clockwise"}
        return opposite[way] if self.falls and way is not None else way

    @property
    def gains_energy(self) -> bool:
        """Whether the loop runs as no passive device does; unknown where the units tell of no work or the output falls."""
        pair = quantity(self.units["u"]), quantity(self.units["y"])
        if self.falls or not (pair in _WORK or pair[::-1] in _WORK):
            return False
        return self.circulation == ("clockwise" if pair in _WORK else "counter-clockwise")

    @property
    def switches(self) -> bool:
        """Whether the output has two values, as that of a thermostat or another switch."""
        return self.y.range > 0 and self.y.range == self.y.resolution

    @property
    def degrading(self) -> bool:
        """Whether the loop loses more stiffness or strength than loops without damage do; unknown in a resonance, a switch, a current."""
        if self.shape is None or self.dynamic or self.switches or self.is_rate:
            return False
        if self.shape.circulation is None:  # the largest loop of a device that broke in it is closed to a line
            return self.weakens
        left = 1.0 if self.stiffness_left is None else self.stiffness_left
        return (
            self.weakens
            or self.softens
            or self.softens_with_stroke
            or left < WEAKER
            or (left < WHOLE and self.shape.pinched)
        )

    @property
    def single_valued(self) -> bool:
        """Whether the branches of the largest loops coincide within the noise: a curve describes them."""
        shape = self.shape
        return shape is not None and shape.circulation is None and not (shape.crossing or self.degrading)

    @property
    def softens(self) -> bool:
        """Whether a force unloads with less stiffness the later it is, at growing strokes."""
        late = self.unloading_left
        return late is not None and late < SOFTER and self.circulation == "clockwise" and not self.dynamic

    @property
    def softens_with_stroke(self) -> bool:
        """Whether branches from the outermost level are softer after larger strokes (Mullins effect)."""
        return self.softening_left is not None and self.softening_left < WEAKER

    @property
    def weakens(self) -> bool:
        """Whether longer branches reach less output than shorter ones before did; unknown in a resonance."""
        return self.strength_left is not None and self.strength_left < WEAKER and not self.dynamic

    @property
    def lags(self) -> bool:
        """Whether the output keeps moving after the input has turned."""
        least = 0.0 if self.delay is None else SHORTEST
        if self.slow_lag is not None:
            return True
        return self.lag is not None and self.lag.samples > max(2 * self.lag.stderr, least)

    @property
    def leads(self) -> bool:
        """Whether the output turns before the input."""
        return self.lag is not None and self.lag.samples < -2 * self.lag.stderr

    @property
    def speed_dependent(self) -> bool:
        """Whether the output turns early, or the area of the loop changes with its duration."""
        widens = self.rate_effect is not None and abs(self.rate_effect) > 0.1 and not self.degrading
        return not self.dynamic and (self.leads or widens)

    @property
    def creeps(self) -> bool:
        """Whether the output moves by more than its noise during a long hold."""
        motion, noise = self.motion, self.y.noise_rms or 0.0
        if motion.longest_hold < LONG_HOLD or motion.hold_creep is None or self.sampling.rate is None:
            return False
        return motion.hold_creep * self.y.range > CLEAR * noise / (motion.longest_hold / 20) ** 0.5


def is_rate(units: Mapping[str, str], of_rate: float) -> bool:
    """Whether an output in these units is the rate of a charge, a flux or an enthalpy.

    Args:
        of_rate: of the output, see `circulation.of_rate`.
    """
    kinds = quantity(units["u"]), quantity(units["y"])
    of_either_sign = kinds in OF_CHARGE | OF_ENTHALPY and abs(of_rate) > OF_RATE
    return of_either_sign or (kinds in _OF_FLUX and (of_rate > OF_RATE or of_rate < -_WIDEST))
