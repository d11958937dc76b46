"""Joints of robots, controllers of processes, calibration sheets and databases of isotherms."""

from __future__ import annotations

import datetime

import numpy as np

from .drawing import Draw
from .physics import lagging, rubbing, triangle, wave
from .registry import kind
from .truth import Layout, loops
from .writing import Column, Dialect, loop, packed, rows, table


def _joint(draw: Draw, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Angle and torque of a joint with friction, shape (n,) each."""
    x = wave(draw, n, draw.whole(2, 4))
    return draw.between(0.3, 1.2) * x, draw.size(1, 40) * draw.noise(rubbing(draw, x), 2e-3)


@kind("joints that take turns")
def turns(draw: Draw) -> Layout:
    n, names = 4 * draw.whole(20, 60), draw.pick(("hip", "knee"), ("joint_1", "joint_2", "joint_3"))
    clock = 1.6e9 + 0.01 * np.arange(n)
    joints = [_joint(draw, n) for _ in names]
    t = Column("time", np.repeat(clock, len(names)), "s", ".3f")
    who = Column("joint", np.tile(names, n))
    u, y = (
        Column(title, np.stack([joint[k] for joint in joints], 1).ravel(), "", ".6f")
        for k, title in enumerate(("position", "effort"))
    )
    at = [slice(k, None, len(names)) for k in range(len(names))]
    lines = ["time,joint,position,effort", *rows([t, who, u, y], Dialect(","))]
    return Layout("", {"joints.csv": packed(draw, lines)}, loops([loop(u, y, t, one) for one in at]))


@kind("messages of a robot")
def messages(draw: Draw) -> Layout:
    """A whole number of nanoseconds since 1970, and positions and efforts of all joints, of which one moves."""
    n, count = 4 * draw.whole(30, 90), draw.whole(2, 4)
    moves, (q, torque) = draw.whole(0, count - 1), _joint(draw, n)
    still = lambda level, size: level + draw.rng.normal(0, size, n)
    stamps = np.array([str(1_600_000_000_123_456_789 + k * 10_000_000) for k in range(n)])
    ros = draw.chance(0.5)
    name = (
        (lambda word, k: f"field.{word}{k}")
        if ros
        else (lambda word, k: f"joint_{k + 1}_{'pos' if word == 'position' else word}")
    )
    angles = [Column(name("position", k), q if k == moves else still(0.3 * k, 1e-5), "", ".6f") for k in range(count)]
    torques = [
        Column(name("effort", k), torque if k == moves else still(1.5 * k, 1e-3), "", ".5f") for k in range(count)
    ]
    lead = [Column("%time" if ros else "timestamp", stamps)]
    lead += [
        Column("field.header.seq", 400.0 + np.arange(n), "", ".0f"),
        Column("field.header.frame_id", np.full(n, "")),
    ] * ros
    lines = table(draw, [*lead, *angles, *torques], Dialect(",", style="none"))
    t = Column("t", 0.01 * np.arange(n), "s", ".4f")
    return Layout("", {"joint_states.csv": packed(draw, lines)}, loops(loop(angles[moves], torques[moves], t)))


@kind("trend of a controller")
def trend(draw: Draw) -> Layout:
    n = 4 * draw.whole(40, 120)
    x = triangle(n, draw.whole(2, 4))
    begin = datetime.datetime(2018, draw.whole(1, 12), draw.whole(1, 28), 7, 15)
    form = draw.pick("%d-%b-%Y %H:%M:%S", "%d %b %y %H:%M:%S", "%Y-%m-%d %H:%M:%S")
    stamps = Column("Timestamp", np.array([f"{begin + datetime.timedelta(seconds=k):{form}}" for k in range(n)]))
    loop_of = draw.pick("FIC101.", "LC-7.", "")
    op = Column(f"{loop_of}OP", 50 + 8 * x, "", ".3f")
    pv = Column(f"{loop_of}PV", draw.noise(40 + 9 * lagging(draw, x), 1e-3), "", ".3f")
    sp = Column(f"{loop_of}SP", np.full(n, 45.0), "", ".1f")
    lines = table(draw, [stamps, *draw.shuffled([sp, pv, op])], Dialect(draw.pick(",", ";"), style="none"))
    return Layout("", {"trend.csv": packed(draw, lines)}, loops(loop(op, pv, Column("t", np.arange(n * 1.0)))))


@kind("calibration cycles side by side")
def cycles(draw: Draw) -> Layout:
    n, count = draw.whole(8, 25), draw.whole(1, 4)
    up, down = draw.pick(("Load", "Unload"), ("Up", "Down"), ("Loading ", "Unloading "))
    rise = np.linspace(0, draw.size(10, 1000), n)
    u = Column(draw.pick("Weight", "Applied force"), rise, draw.pick("N", "kN"), ".6g")
    gap, size = np.sin(np.pi * np.arange(n) / (n - 1)), draw.size(1, 4000)
    branches = [size * (rise / rise[-1] + 0.004 * k + sign * gap) for k in range(count) for sign in (0, 0.08)]
    names = [f"{word}{k + 1}" for k in range(count) for word in (up, down)]
    columns = [Column(name, y, "", ".5g") for name, y in zip(names, branches, strict=True)]
    lines = table(draw, [u, *columns], Dialect(draw.pick(",", ";", "\t"), style="parentheses"))
    way = lambda of: np.concatenate([one.written[:: 1 - 2 * (k % 2)] for k, one in enumerate(of)])
    truth = loop(Column("u", way([u] * len(columns)), u.unit, ".17g"), Column("y", way(columns), "", ".17g"))
    return Layout("", {"calibration.csv": packed(draw, lines)}, loops(truth))


@kind("units in columns of their own")
def units(draw: Draw) -> Layout:
    n = 2 * draw.whole(15, 40)
    p = (1 + 0.98 * triangle(n, 1, 0.75)) / 2
    u = Column("pressure", 90 * p, draw.pick("kPa", "bar"), ".4f")
    y = Column("loading", draw.noise(5 + 20 * lagging(draw, 2 * p - 1, 0.5), 5e-4), draw.pick("mg", "mmol/g"), ".4f")
    texts = [Column(f"{one.name}_units", np.full(n, one.unit)) for one in (u, y)]
    texts += [Column("adsorbate", np.full(n, "Xe")), Column("run_id", np.ones(n), "", ".0f")]
    branch = Column("branch", np.repeat(["A", "D"], n // 2))
    lines = table(draw, [*draw.shuffled(texts), u, y, branch], Dialect(",", style="none"))
    return Layout("", {"isotherms.csv": packed(draw, lines)}, loops(loop(u, y)))


@kind("targets and measurements of a robot")
def targets(draw: Draw) -> Layout:
    """Commanded and measured positions and currents of a joint, and the moment that the controller computes ahead."""
    n = 4 * draw.whole(40, 120)
    q, current = _joint(draw, n)
    ahead = 0.8 * current.max() * q / np.abs(q).max()
    mark, of = (
        draw.pick(("_", "_1"), ("_", "_3"), ("_", "")),
        draw.pick(("target", "actual"), ("cmd", "meas"), ("desired", "measured")),
    )
    name = lambda side, word: f"{of[side]}{mark[0]}{word}{mark[1]}"
    t = Column("timestamp", 0.008 * np.arange(n), "s", ".3f")
    x = Column(name(1, "q"), q + draw.rng.normal(0, 2e-5, n), "", ".6f")
    y = Column(name(1, "current"), current, "", ".5f")
    others = [Column(name(0, "q"), q, "", ".6f"), Column(name(0, "current"), ahead, "", ".5f")]
    others.append(Column(name(0, "moment"), 9.3 * ahead, "", ".4f"))
    columns = [t, others[0], x, others[1], y, *([others[2]] if draw.chance(0.6) else [])]
    return Layout(
        "",
        {"robot.csv": packed(draw, table(draw, columns, Dialect(draw.pick(",", " "), style="none")))},
        loops(loop(x, y, t)),
    )
