"""The physical quantity of a column, by its name and unit, and its role; `column_names.toml` holds the words that names are made of."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable

from hystfit.params.units import OF_BRIDGES, quantity, symbol_of
from hystfit.reading.names.branch_words import words_of
from hystfit.reading.names.names_with_units import RATIO, split_unit
from hystfit.reading.names.unit_case import in_case
from hystfit.reading.names.vocabulary import ROLES, VOCABULARY, WORDS

_LETTERS: dict[str, str] = VOCABULARY["letters"]
_STATED_AS: dict[str, list[str]] = VOCABULARY["stated_as"]
_DRIVERS = frozenset(VOCABULARY["drivers"].split())
_MEASURED = frozenset(VOCABULARY["measured"].split())
_SECONDARY = frozenset(VOCABULARY["secondary"].split())
SIDES = frozenset(VOCABULARY["sides"].split())
MEANS = frozenset(VOCABULARY["means"].split())
_DIRECTIONS = ("x", "y", "z")
_CHANNEL = re.compile(
    r"(?:lock-?in|ch|chan|channel|kanal|voie|canal|ai|col|column|sensor|signal|trace)[ _.-]?[a-z0-9]\d?", re.IGNORECASE
)
# Voltages and currents of terminals and of source-measure units: AnodeV, GateI, AV, VForce, Imeas, VGS, I_D.
_TERMINAL = re.compile(
    r"(?:[Aa]node|[Cc]athode|[Dd]rain|[Gg]ate|[Ss]ource|[Bb]ulk|[ADG])_?([VI])\d?"
    r"|([VI])(?:_?(?:[Ff]orce|[Mm]eas|[Ss]ense|[Rr]ead|[Ww]rite|[Dd]rain|[Gg]ate|[GDSB]{2}|[gdsb]{2}|[Gg]|rms|RMS|pp|dc|DC|ac|AC)|_[DSBdsb])\d?"
    r"|(V)[DSBdsb]\d?"
)
_REMARK = re.compile(r"\s*[(\[][^()\[\]]*[)\]]")  # on a name: Cycle Count(Digital Position)
_OF_GATE = re.compile(r"V_?[Gg][Ss]?\d?")
_TEMPERATURES = re.compile(
    r"T[_ ]?(?:stage|sample|chamber|room|amb|ambient|env|probe|set|bath|oven|cold|hot|c|C)\d?|T[AS]_F(?:_MDS)?(?:_\d)?"
)
# Net exchange of an ecosystem, its photosynthesis and its respiration, as FLUXNET names them: "REF" is no reference there.
_EXCHANGE = re.compile(r"(?:NEE|GPP|RECO)(?:_[A-Z]+)*(?:_\d)?")
# Tags of process control: LIC101.PV, FIC-7/OUT, TIC_3.SP.
_TAG = re.compile(r"[A-Z]{2,5}[-_ ]?\d+\w?[./_ :](?:(OUT|OP|CO|MV)|PV|SP)")
# Entities of home automation by their kind, switch.heater and sensor.room_temperature: those that act, and those that measure.
_ENTITY = re.compile(r"(?:(switch|number|light|fan|cover|valve|climate|input_\w+)|(?:binary_)?sensor)\.\w+")
RELATIVE_PRESSURE = re.compile(r"(?<!\w)p_?e?q? ?/ ?p_?[0os₀]?(?!\w)", re.IGNORECASE)
_RATIOS = ("%", "‰", "ppm")
_FIELD_SYMBOL = re.compile(r"([HBMJ])(?:meas|field|exp|data)")


_of_names = functools.lru_cache(maxsize=4096)  # every file and fit asks for the same few names, many times


@_of_names
def column_quantity(name: str, unit: str = "") -> str:
    """Physical quantity of a column ("time", "voltage", "displacement", ..., "" if unknown), by its name and its unit."""
    base, unit_of_name = split_unit(name)
    by_unit = quantity(unit or unit_of_name)
    if re.fullmatch(r"T(?:[a-z0-9]*|_\w+)|[A-Za-z]+_T|t_?(?:a|s|w|air|soil|water|leaf)", base) and by_unit in (
        "charge",
        "capacitance",
    ):
        return "temperature"  # T or Ta in degrees Celsius without their sign
    if by_unit == "voltage" and re.fullmatch(r"E_\w+", base):
        return by_unit  # the potential of an electrode
    if by_unit == "stress" and re.fullmatch(r"p(?: ?c(?:ap)?)?", without_role(name)):
        return "pressure"  # whose unit is that of a stress, also the capillary one
    base = _field(base)
    if RATIO.fullmatch(base) and not RELATIVE_PRESSURE.search(base):
        base = base[0]
    base, of_matrix = re.subn(r"\[\d+\]$", "", base.strip().removesuffix("(t)"))
    if of_matrix and "_" in base:  # a column of a matrix x_F has no name of its own, and tau_J[3] is a torque
        spelled = {WORDS[word] for word in base.lower().split("_") if len(word) > 1 and word in WORDS}
        return by_unit or (spelled.pop() if len(spelled) == 1 else "")
    if _CHANNEL.fullmatch(base):
        return by_unit  # its letter is that of the channel
    if _TEMPERATURES.fullmatch(base):
        return "temperature"
    if terminal := _TERMINAL.fullmatch(base):
        base = terminal[1] or terminal[2] or terminal[3]
    if base in _LETTERS and by_unit in ("", _LETTERS[base]):
        return _LETTERS[base]
    kinds = _named_quantities(_REMARK.sub(" ", base)) or _named_quantities(base)
    if by_unit == "stress" and {"potential", "tension"}.intersection(_words(base)):
        return "pressure"  # of water in soil and plants
    for strong in ("temperature", "error", "status", "frequency", "phase"):  # the unit C alone would be a charge
        if strong in kinds and (strong, by_unit) != ("frequency", "time"):
            return strong
    if base.lower() == "time":
        return "time"  # whatever stands in the place of its unit
    for strong in ("index", "time"):
        if strong in kinds and not (strong == "index" and (by_unit or len(kinds) > 1)):
            return strong if not (strong == "time" and by_unit not in ("", "time")) else by_unit
    named = WORDS.get(_joined(base)) or (kinds[-1] if kinds else "")
    stated = unit or unit_of_name
    if not by_unit and (stated.startswith("dB") or (stated and named == "charge")):
        return ""  # a level is no force, and Q in m3/s is a flow
    if by_unit == "charge" and stated == "C" and not named and len(base) > 1:
        return "temperature"  # of channels that have a number or the name of a port
    if named == "stress" and stated in _RATIOS:
        return "strain"  # S in percent, beside an electric field
    if named in _STATED_AS.get(by_unit, ()) and (len(base) > 1 or base in "HMJ"):
        return named
    if named == "wavelength" and base.lower().startswith(("λ", "lambda")):
        return "strain"  # of a magnetostrictive material, or a stretch
    return by_unit or named or ("velocity" if base == "v" else "")


def _field(base: str) -> str:
    """The name at the end of a path (t in experiment.data.t) where it has a meaning, and the one before a direction (force.z).

    Other names are as they are, without the container of messages of robots (field.data). Behind two colons it is the name of a quantity
    of a part of a program (Oxs_UZeeman::Bx).
    """
    path = re.fullmatch(r"(?:\w+\.)+([A-Za-z]\w*)|[\w:]+::([A-Za-z][\w ]*)", base)
    if not path:
        return base
    if path[2]:
        return path[2]
    *before, last = base.removeprefix("field.").split(".")
    if last in _DIRECTIONS and before and any(word in WORDS for word in _words(before[-1])):
        return before[-1]
    return (
        last
        if len(last) == 1 or any(word in WORDS or word in ROLES for word in _words(last))
        else ".".join((*before, last))
    )


def column_unit(name: str, unit: str) -> str:
    """The unit of a column, in its case; a symbol where it is the name too; degrees without their sign are named so."""
    unit = in_case(split_unit(name)[0], unit) or unit
    if unit == name:
        return symbol_of(unit)
    return f"deg{unit}" if unit in ("C", "F") and column_quantity(name, unit) == "temperature" else unit


def has_terminals(names: Iterable[str]) -> bool:
    """Whether columns are those of a transistor: one has the name of the voltage of a gate."""
    return any(_OF_GATE.fullmatch(split_unit(name)[0]) for name in names)


def is_terminal(name: str) -> bool:
    """Whether a column is the voltage or current of one terminal of a device (GateV, DrainI)."""
    return _TERMINAL.fullmatch(split_unit(name)[0]) is not None


@_of_names
def column_role(name: str) -> str:
    """Whether the name of a column says that it is the "input" or the "output" of a device; "" for other names."""
    if entity := _ENTITY.fullmatch(name):
        return "input" if entity[1] else "output"
    if tag := _TAG.fullmatch(name):
        return "input" if tag[1] else "output" if name.endswith("PV") else ""
    base = _field(split_unit(name)[0].strip())
    if _EXCHANGE.fullmatch(base) or split_unit(name)[1] in OF_BRIDGES:
        return "output"
    if base in _LETTERS:
        return ""  # U is the symbol of a voltage, and u of an input
    first, _, rest = base.lower().partition("_")
    symbol = rest and first == "u" and quantity(split_unit(name)[1]) == "voltage"  # u_sek [V]
    words = [word for word in _words(base) if len(word) > 1 or (word == first and not symbol)]  # tip_y is along an axis
    told = [word for word in words if word in ROLES]
    others = {word for word in base.lower().split("_") if len(word) > 1} - {"in"}
    if {*told} == {"in"} and others and not others.intersection(WORDS):
        return ""  # radiation that comes in: sw_in
    roles = {ROLES[word] for word in told}
    gauge = "hall" in told and quantity(split_unit(name)[1]) == "induction"  # of the field that is applied
    if gauge or (roles == {"input"} and _MEASURED.intersection(words)):
        return ""  # what supplies a controller that reports its input voltage
    if roles == {"output"} and _DRIVERS.intersection(_words(split_unit(name)[0].replace(".", "_"))):
        return "input"  # source.y of a model too
    return roles.pop() if len(roles) == 1 else ""


@_of_names
def is_bare_role(name: str) -> bool:
    """Whether the name of a column says which role it has and nothing of its quantity ("Sensor output")."""
    return column_role(name) != "" and not _named_quantities(split_unit(name)[0].strip())


@_of_names
def without_role(name: str) -> str:
    """A name without the words that say whether it is commanded or measured: q_1 of target_q_1 and of actual_q_1."""
    words = re.split(r"[\W_]+|(?<=[a-z])(?=[A-Z])", _field(split_unit(name)[0].strip()))
    return " ".join(word.lower() for word in words if word.lower() not in ROLES and word.lower() not in _MEASURED)


@_of_names
def parts_of(name: str) -> frozenset[str]:
    """Words, letters and numbers in a name that tell which part of a device or axis it is of: x of Disp_X_mm, joint and 1 of joint_1."""
    return frozenset(words_of(split_unit(name)[0]))


@_of_names
def is_channel(name: str) -> bool:
    """Whether a column has the number or letter of a channel instead of a name."""
    return _CHANNEL.fullmatch(split_unit(name)[0].strip()) is not None


@_of_names
def secondary(name: str) -> int:
    """Number of words in a name by which it comes after other columns of its quantity ("Min. Field", "Raw Moment")."""
    return len(_SECONDARY.intersection(_words(name)))


def _named_quantities(base: str) -> list[str]:
    """Quantities of the words in a name, those of its own words first."""
    known = [word for word in _words(re.sub(r"<(\w+)>", r"\1", base)) if word in WORDS]
    if len(set(known)) > 1:  # the axis of F_x is no displacement
        known = [word for word in known if word not in ("x", "y", "z")]
    kinds = [WORDS[word] for word in known]
    kinds += [kind for word, kind in WORDS.items() if not word.isascii() and word in base.lower()]
    if "displac" in base.lower():
        kinds.append("displacement")
    if RELATIVE_PRESSURE.search(base):
        kinds.append("pressure")
    if symbol := _FIELD_SYMBOL.match(base):
        kinds.append({"H": "field", "B": "induction"}.get(symbol[1], "magnetization"))
    return kinds


def _words(base: str) -> list[str]:
    """Words in a column's name, in lower case: the whole name, its parts between underscores, and those of CamelCase."""
    tokens = [token.strip() for token in base.lower().split("_")]
    camel = [part.lower() for part in re.findall(r"[A-Z]?[a-z]{2,}|(?!NO[\dx])[A-Z]{2,}(?![a-z])", base)]
    return [base.lower(), _joined(base), *tokens, *camel]


def _joined(base: str) -> str:
    """A whole name as one word: shear_rate of "Shear Rate"."""
    return base.lower().replace(" ", "_")
