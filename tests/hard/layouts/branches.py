"""Branches side by side or in files of their own, demagnetization curves, electrical steels and ring testers."""

from __future__ import annotations

import numpy as np

from .drawing import Draw
from .physics import lagging, major_loop, saturating, sine
from .registry import kind
from .truth import Layout, Loop, Records, loops
from .writing import Column, Dialect, loop, packed, table

_QUANTITIES = (
    ("H", "A/m", "B", "T"),
    ("H", "Oe", "M", "emu"),
    ("V", "V", "x", "um"),
    ("E", "kV/cm", "P", "uC/cm2"),
    ("H", "kA/m", "J", "T"),
)
_LONG = {
    "H": "Field",
    "B": "Induction",
    "M": "Moment",
    "V": "Voltage",
    "x": "Displacement",
    "E": "Field",
    "P": "Polarization",
    "J": "Polarization",
}


_OTHER_WORDS = (
    ("trace", "retrace"),
    ("extend", "retract"),
    ("Ex", "Rt"),
    ("auf", "ab"),
    ("Hin", "Rück"),
    ("Belastung", "Entlastung"),
    ("montée", "descente"),
    ("aller", "retour"),
    ("加载", "卸载"),
)


def _branches(
    draw: Draw, rising: int, falling: int, quantity: tuple[str, str, str, str]
) -> tuple[list[Column], list[Column]]:
    """Input and output of the rising and of the falling branch of a closed loop."""
    up, down = np.linspace(-1, 1, rising), np.linspace(1, -1, falling)
    device = saturating if quantity[0] in "HE" else lagging
    y = device(draw, np.r_[down, up, down])[falling:]
    y = draw.noise(y, 5e-4) * draw.size(0.1, 5)
    size = draw.size(1, 1000)
    pair = lambda u, v: [Column("u", size * u, quantity[1], ".6g"), Column("y", v, quantity[3], ".6g")]
    return pair(up, y[:rising]), pair(down, y[rising:])


def _joined(one: list[Column], other: list[Column]) -> tuple[Records, ...]:
    """The loop of two branches, beginning with either."""
    both = lambda a, b: Loop(*(np.r_[p.written, q.written] for p, q in zip(a, b, strict=True)), a[0].unit, a[1].unit)
    return loops(both(one, other), both(other, one))


def _reversed(branch: list[Column]) -> list[Column]:
    return [Column(c.name, c.values[::-1], c.unit, c.form, c.spelled) for c in branch]


def _side_by_side(draw: Draw, words: tuple[str, str], form: str, equal: bool) -> Layout:
    """Both branches in four columns.

    Args:
        words: of the rising and the falling branch.
        form: of a column's name.
    """
    quantity = draw.pick(*_QUANTITIES)
    rising = draw.whole(60, 250)
    up, down = _branches(draw, rising, rising if equal else draw.whole(60, 250), quantity)
    glued = form == "{base}{word}" and words[0].islower()
    base = [quantity[0], quantity[2]] if glued or draw.chance(0.5) else [_LONG[quantity[0]], _LONG[quantity[2]]]
    named = lambda branch, word: [c.renamed(form.format(base=b, word=word)) for c, b in zip(branch, base, strict=True)]
    shown = _reversed(down) if equal and draw.chance(0.2) else down
    one, other = named(up, words[0]), named(shown, words[1])
    columns = [*other, *one] if draw.chance(0.4) else [*one, *other]
    style = draw.pick("parentheses", "brackets", "row")
    lines = table(draw, columns, Dialect(draw.pick(",", "\t", ";"), style=style))
    return Layout("", {draw.pick("branches.csv", "loop.txt"): packed(draw, lines)}, _joined(up, down))


@kind("branches side by side")
def side_by_side(draw: Draw) -> Layout:
    words = draw.pick(
        ("up", "down"),
        ("asc", "desc"),
        ("ascending", "descending"),
        ("increasing", "decreasing"),
        ("rising", "falling"),
        *_OTHER_WORDS,
    )
    return _side_by_side(draw, words, draw.pick("{base}_{word}", "{base} {word}", "{word} {base}"), draw.chance(0.5))


@kind("branches with glued names")
def glued(draw: Draw) -> Layout:
    words = draw.pick(("up", "down"), ("Up", "Down"), ("asc", "desc"), ("inc", "dec"), ("Asc", "Desc"))
    return _side_by_side(draw, words, "{base}{word}", draw.chance(0.5))


@kind("two outputs over one input")
def one_input(draw: Draw) -> Layout:
    quantity, n = draw.pick(*_QUANTITIES), draw.whole(60, 250)
    up, down = _branches(draw, n, n, quantity)
    words = draw.pick(
        ("up", "down"),
        ("increasing", "decreasing"),
        ("forward", "backward"),
        ("loading", "unloading"),
        ("asc", "desc"),
        *_OTHER_WORDS,
    )
    y = quantity[2]
    columns = [
        up[0].renamed(quantity[0]),
        up[1].renamed(f"{y}_{words[0]}"),
        _reversed(down)[1].renamed(f"{y}_{words[1]}"),
    ]
    columns = [columns[0], columns[2], columns[1]] if draw.chance(0.3) else columns
    lines = table(draw, columns, Dialect(draw.pick(",", "\t", ";"), style=draw.pick("parentheses", "brackets", "row")))
    return Layout("", {draw.pick("loop.csv", "updown.txt"): packed(draw, lines)}, _joined(up, down))


@kind("half cycles in two files")
def two_files(draw: Draw) -> Layout:
    quantity = draw.pick(*_QUANTITIES)
    up, down = _branches(draw, draw.whole(60, 250), draw.whole(60, 250), quantity)
    dialect = Dialect(draw.pick(",", "\t"), style=draw.pick("parentheses", "brackets"))
    named = lambda branch: [c.renamed(n) for c, n in zip(branch, (quantity[0], quantity[2]), strict=True)]
    words = draw.pick(("up", "down"), ("1", "2"), ("asc", "desc"))
    parts = {f"loop_{word}.csv": branch for word, branch in zip(words, (up, down), strict=True)}
    files = {name: packed(draw, table(draw, named(branch), dialect), ("utf-8",)) for name, branch in parts.items()}
    return Layout("", files, (*_joined(up, down), (loop(*up), loop(*down))))


@kind("second-quadrant curve")
def second_quadrant(draw: Draw) -> Layout:
    n, coercive, remanence = draw.whole(15, 120), draw.size(40, 900), draw.between(0.4, 1.4)
    h = -np.linspace(0, 1, n) if draw.chance(0.5) else np.linspace(-1, 0, n)
    j = remanence * (1 - np.abs(h) ** draw.whole(4, 12)) + 0.02 * h
    unit, size = draw.pick(("kA/m", 1.0), ("A/m", 1e3), ("kOe", 4e-3 * np.pi))
    b_unit, b_size = draw.pick(("T", 1.0), ("T", 1.0), ("mT", 1e3)) if unit != "kOe" else ("kG", 10.0)
    field = coercive * h
    u = Column("H", field * size, unit, ".6g")
    b = Column("B", (j + 4e-7 * np.pi * 1e3 * field) * b_size, b_unit, ".5g")
    polarization = Column("J", j * b_size, b_unit, ".5g")
    columns = [u, b, polarization] if draw.chance(0.3) else [u, b]
    columns = [columns[1], columns[0], *columns[2:]] if draw.chance(0.2) else columns
    truths = loops(loop(u, b), *(loop(u, polarization) for _ in columns[2:]))
    above = draw.pick([], ["Material: NdFeB N42, 20 °C"], ["# AlNiCo 5, data sheet"])
    lines = above + table(
        draw,
        columns,
        Dialect(draw.pick(",", "\t", ";", "\t"), style=draw.pick("parentheses", "brackets", "row", "slash")),
    )
    return Layout(
        "", {draw.pick("N42.tab", "B(H).AlNiCo.tab", "demag.csv"): packed(draw, lines)}, truths, may_ask=len(truths) > 1
    )


@kind("B-H data sheet")
def data_sheet(draw: Draw) -> Layout:
    n = draw.whole(15, 80)
    h = draw.size(500, 60000) * np.r_[0, np.geomspace(1e-3, 1, n - 1)]
    b = draw.between(0.4, 1.8) * np.tanh(h / h.max() * 12) + 4e-7 * np.pi * h
    names = draw.pick(("H", "B"), ("Magnetic field strength H", "Flux density B"), ("Field", "Induction"))
    u, y = Column(names[0], h, "A/m", ".6g"), Column(names[1], b, "T", ".5g")
    style = draw.pick("parentheses", "brackets", "row", "underscore" if len(names[0]) == 1 else "slash")
    lines = draw.pick([], ["Material: M400-50A"], ["* BH curve of Steel 1010"]) + table(
        draw, [u, y], Dialect(draw.pick(",", "\t", ";"), style=style)
    )
    return Layout("", {draw.pick("M400-50A.tab", "bh.csv", "steel1010.BH"): packed(draw, lines)}, loops(loop(u, y)))


@kind("electrical steel over frequencies")
def frequencies(draw: Draw) -> Layout:
    parts, levels = [], draw.shuffled([5.0, 10.0, 50.0, 100.0, 400.0])[: draw.whole(2, 4)]
    for level in sorted(levels):
        n = draw.whole(80, 200)
        h = sine(n + 1, 1, 0.25)[:-1] * (100 + 2 * level)
        b = draw.noise(1.2 * saturating(draw, h / h.max(), begin=1, coercive=0.2 + level / 2000), 1e-3)
        parts.append((np.full(n, level), h, b))
    f, h, b = (np.concatenate(part) for part in zip(*parts, strict=True))
    frequency = Column(draw.pick("Frequency", "f", "Freq"), f, "Hz", ".0f", "Hz")
    u, y = Column("H", h, "A/m", ".5g"), Column("B", b, "T", ".5g")
    columns = [frequency, u, y] if draw.chance(0.7) else [u, y, frequency]
    lines = table(draw, columns, Dialect(draw.pick(",", "\t", ";"), style=draw.pick("parentheses", "brackets", "row")))
    each = [loop(u, y, rows=np.flatnonzero(f == level)) for level in sorted(levels)]
    return Layout("", {draw.pick("M270-35A.csv", "steel loops.txt"): packed(draw, lines)}, loops(each))


@kind("Epstein and ring tester")
def epstein(draw: Draw) -> Layout:
    n = 2 * draw.whole(100, 300)
    h = draw.size(50, 5000) * sine(n, 1)
    b = draw.noise(draw.between(0.3, 1.7) * saturating(draw, h / h.max(), begin=draw.pick(-1, 1)), 1e-3)
    t = Column(draw.pick("t", "Time", "time"), np.arange(n) * 0.1, "ms", ".3f")
    u, y = Column("H", h, "A/m", ".5f", "A/m"), Column(draw.pick("B", "J"), b, "T", ".6f", "T")
    amps = Column(draw.pick("I1", "Primary current"), h / 500, "A", ".5f", "A")
    volts = Column(draw.pick("U2", "Secondary voltage"), np.gradient(b) * 40, "V", ".5f", "V")
    beside = [column for column in (amps, volts) if draw.chance(0.5)]
    columns = [t, *draw.pick([*beside, u, y], [u, y, *beside])]
    comma = draw.chance(0.4)
    above = ["Brockhaus MPG 200", "Material: M400-50A", "Frequency: 50 Hz", "Jmax: 1.5 T", ""][: draw.pick(0, 5)]
    dialect = Dialect(
        draw.pick("\t", ";"), "," if comma else ".", draw.pick("brackets", "row", "slash", "row in brackets")
    )
    return Layout(
        "",
        {draw.pick("M400_50Hz.csv", "ring core.txt"): packed(draw, above + table(draw, columns, dialect))},
        loops(loop(u, y)),
    )


@kind("outputs at several conditions")
def conditions(draw: Draw) -> Layout:
    n, count = 2 * draw.whole(60, 200), draw.whole(2, 5)
    field = draw.size(100, 20000) * major_loop(n)
    h = Column(draw.pick("H", "Field", "Magnetic Field"), field, draw.pick("Oe", "A/m", "mT"), ".6g")
    unit, values = draw.pick(
        ("K", (5, 77, 150, 300, 400)), ("Hz", (10, 50, 100, 400, 1000)), ("°C", (25, 60, 90, 120, 150))
    )
    form = draw.pick("M {value} {unit}", "M_{value}{unit}", "M at {value} {unit}", "M({value}{unit})", "{value} {unit}")
    bare = form.startswith("{value}")
    outputs = [
        Column(
            form.format(value=value, unit=unit),
            draw.noise(draw.size(0.5, 2) * saturating(draw, field / field.max(), begin=1), 1e-3),
            "" if bare else "emu",
            ".5g",
        )
        for value in values[:count]
    ]
    style = draw.pick("parentheses", "brackets") if not form.endswith(")") else "brackets"
    lines = table(draw, [h, *outputs], Dialect(draw.pick(",", "\t", ";"), style=style))
    return Layout("", {draw.pick("loops.csv", "MH.txt"): packed(draw, lines)}, (tuple(loop(h, y) for y in outputs),))
