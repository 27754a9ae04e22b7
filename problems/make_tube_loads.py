"""Remake tube_loads.csv: the drag of the rod on the bore, as a load cell would have logged it.

A programme of ramps, holds, reversals and a few quick cycles, sampled at 4 Hz. The log has a
slow drift, noise of about 20 Pa and a resolution of 5 Pa; all of it is deterministic, so the file
is the same wherever it is made.
"""

import math
from itertools import pairwise
from pathlib import Path

RATE = 4  # samples a second
PROGRAMME = [  # time (s), traction (Pa); straight in between
    (0.0, 0.0),
    (3.0, 0.0),
    (24.0, 21e3),
    (36.0, 21e3),  # pull out, hold: the body creeps
    (58.0, -19e3),
    (68.0, -19e3),  # push back: the slip reverses
    (80.0, 13e3),
    (84.0, 2e3),
    (88.0, 13e3),
    (92.0, 2e3),
    (96.0, 13e3),  # cycles too small to slip everywhere
    (108.0, 0.0),
    (120.0, 0.0),  # let go: residual stress stays locked in by friction
]
RESOLUTION, NOISE, DRIFT = 5.0, 20.0, 60.0


def programme(t: float) -> float:
    """The commanded traction in Pa."""
    for (t0, f0), (t1, f1) in pairwise(PROGRAMME):
        if t <= t1:
            return f0 + (f1 - f0) * (t - t0) / (t1 - t0)
    return PROGRAMME[-1][1]


def noise(k: int) -> float:
    """A number in [-1, 1] from a sample's index: the sum of two hashed dice."""
    dice = [(k * step + 12345) % 65537 * 40503 % 65536 / 65535 for step in (25173, 31821)]
    return sum(dice) - 1.0


def main() -> None:
    """Write the log beside this file."""
    lines = [
        "# Drag on the bore of the tube: a deterministic stand-in for a load cell's log",
        "# t: time (s); f2: axial traction on the arc 'pulled' (Pa); command: programmed f2 (Pa)",
        "t,f2,command",
    ]
    for k in range(120 * RATE + 1):
        t = k / RATE
        measured = programme(t) + DRIFT * math.sin(2 * math.pi * t / 97.0) + NOISE * noise(k)
        logged = RESOLUTION * round(measured / RESOLUTION) if k else 0.0
        lines.append(f"{t:.2f},{logged:.0f},{programme(t):.1f}")
    text = "\n".join(lines) + "\n"
    Path(__file__).with_name("tube_loads.csv").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
