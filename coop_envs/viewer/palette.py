"""The viewer's colours, RGB. Robots, policies and map states stay apart for most colour-blind eyes and in print."""

from __future__ import annotations

Rgb = tuple[int, int, int]

PAPER: Rgb = (255, 255, 255)
INK: Rgb = (31, 36, 43)
MUTED: Rgb = (104, 112, 122)
RULE: Rgb = (222, 224, 227)

FLOOR: Rgb = (233, 231, 226)
HIGH_GROUND: Rgb = (118, 122, 130)
LOW_GROUND: Rgb = (176, 184, 194)
NO_GROUND: Rgb = (247, 247, 245)

PROVEN: Rgb = (38, 160, 96)
HAZARD: Rgb = (240, 96, 32)
OBSTACLE: Rgb = (52, 62, 92)
SEEN_FREE: Rgb = (56, 150, 214)
LASER: Rgb = (226, 26, 58)
HEIGHTS: tuple[Rgb, ...] = ((46, 20, 128), (150, 24, 154), (222, 80, 96), (252, 158, 60), (246, 232, 90))
"""From low to high."""
TRUE_HAZARDS: dict[str, Rgb] = {"trap": (178, 24, 43), "hole": (20, 20, 24), "slippery": (33, 113, 181)}

GOAL: Rgb = (245, 190, 40)
LOST: Rgb = (146, 150, 156)
OBSERVERS: tuple[Rgb, ...] = ((29, 78, 216), (2, 132, 199), (30, 58, 138), (79, 70, 229))
PICKETS: tuple[Rgb, ...] = ((162, 28, 175), (8, 145, 138), (120, 53, 15), (219, 39, 119), (101, 84, 192))

POLICIES = ("#1d4ed8", "#c2410c", "#0f766e", "#a21caf", "#b45309", "#4d7c0f", "#be123c", "#475569")


def robot_colours(roles: tuple[str, ...]) -> list[Rgb]:
    """A colour for each robot: blues for observers, others for pickets, in turn."""
    colours: list[Rgb] = []
    for i, role in enumerate(roles):
        wheel = OBSERVERS if role == "observer" else PICKETS
        colours.append(wheel[roles[:i].count(role) % len(wheel)])
    return colours


def mixed(colour: Rgb, other: Rgb, share: float) -> Rgb:
    """``share`` of ``other`` in ``colour``."""
    r, g, b = (round(a + (c - a) * share) for a, c in zip(colour, other, strict=True))
    return r, g, b
