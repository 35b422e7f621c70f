"""The Granite Lab at NASA Ames and what stands in it, from public numbers (chapter 1).

World frame: metres, x and y on the table, z up, origin at the middle of the table top. The published model has z down;
turning z up and keeping x and y makes our room its mirror image, which no method in this book can tell.

Published, with where each number is from:

- table, walls, dock's place, height of the robot: NASA's Gazebo models (nasa/astrobee_media `granite.dae`,
  nasa/isaac `granite.world`); the table's 2 x 2 m also in the paper
- dock: nasa/astrobee_media, bounding box of the mesh
- Astrobee: nasa/astrobee `model.urdf.xacro`, collision boxes
- cargo bag: ISAAC's mesh of a cargo transfer bag (a "1.0 CTB" in NASA's brief measures 0.502 x 0.425 x 0.248 m)
- handrail: nasa/isaac `granite.world` has one 21.5 inches long on the wall x = 1; its section is the mesh's

Stand-ins, chosen here: the crate (no public model); the carriage under Astrobee, the dock's stand and where on the dock
the robot berths; the bag's seams and straps; the panels, seat tracks, vent, lamp and cable pipe that keep the walls
from being bare (in the real lab they carry pictures of the space station).
"""

from __future__ import annotations

import numpy as np

from gmmcd_teach.lab.shapes import Box, Cylinder, Floats, Solid, axis_along, pose_at
from gmmcd_teach.lab.world import Scene, Thing

TABLE = (2.0, 2.0, 0.5)  # granite.dae: top at z = 0
PEDESTAL = (1.5, 1.5, 0.5)  # granite.dae: the lower block
WALL_WIDTH, WALL_HEIGHT, WALL_THICKNESS = 0.9, 2.0, 0.01  # granite.dae: six of them, at x = -1, x = 1 and y = -1
WALL_CENTRES = (-0.5, 0.5)  # granite.dae: along each side, so that 10 cm are open between two walls
ROOM = (6.0, 12.0, 5.0)  # granite.world: the walls of the hall; its floor is the pedestal's foot
DOCK = (0.176, 0.775, 0.381)
DOCK_PLACE = (-0.825, 0.288, 0.675)  # granite.world
ROBOT_HEIGHT = DOCK_PLACE[2]  # Astrobee glides at the height of its dock
ASTROBEE_BODY = (0.290513, 0.151942, 0.281129)  # model.urdf.xacro
ASTROBEE_MODULE = (0.319199, 0.083962, 0.319588)  # model.urdf.xacro: one propulsion module on each side
ASTROBEE_MODULE_AT = 0.117546  # model.urdf.xacro: its centre, to the side
CARGO_BAG = (0.267, 0.465, 0.552)  # ISAAC's mesh, standing on its short side
CRATE = (0.40, 0.45, 0.35)  # stand-in
HANDRAIL_LENGTH, HANDRAIL_WIDTH, HANDRAIL_STANDOFF = 0.546, 0.032, 0.078  # 21.5 inches; section from the mesh
SEARCH_BOUNDARY = ((-1.05, -1.05, -0.05), (1.05, 1.05, 2.05))  # the lab and 5 cm around it: clouds are cropped to this


def box(size: tuple[float, float, float], x: float = 0, y: float = 0, z: float = 0) -> Box:
    """A box of `size` with its centre at (x, y, z) of the thing's frame."""
    return Box(size, pose=pose_at(x, y, z))


def bar(diameter: float, length: float, axis: str, x: float = 0, y: float = 0, z: float = 0) -> Cylinder:
    """A round bar along "x", "y" or "z" with its centre at (x, y, z) of the thing's frame."""
    return Cylinder(diameter, length, pose=pose_at(x, y, z) @ axis_along(axis))


def astrobee(name: str = "astrobee", *, at: Floats) -> Thing:
    """A free-flying robot on its carriage; `at` (4, 4): its place on the table, facing +x."""
    w, d, h = ASTROBEE_MODULE
    parts: list[Solid] = [box(ASTROBEE_BODY, z=ROBOT_HEIGHT)]
    for side in (-1, 1):
        parts += [
            box((w, d, h - 0.06), y=side * ASTROBEE_MODULE_AT, z=ROBOT_HEIGHT),
            box((w - 0.06, d, h), y=side * ASTROBEE_MODULE_AT, z=ROBOT_HEIGHT),
            bar(0.16, 0.012, "y", y=side * (ASTROBEE_MODULE_AT + d / 2 + 0.006), z=ROBOT_HEIGHT),  # intake grille
        ]
    parts += [
        bar(0.05, 0.03, "x", ASTROBEE_BODY[0] / 2 + 0.015, 0, ROBOT_HEIGHT + 0.07),  # cameras, in front
        bar(0.10, ROBOT_HEIGHT - h / 2 - 0.05, "z", z=(ROBOT_HEIGHT - h / 2 + 0.05) / 2),  # carriage: stand-in
        box((0.24, 0.24, 0.03), z=ROBOT_HEIGHT - h / 2 - 0.015),
        box((0.30, 0.30, 0.02), z=0.06),
    ]
    parts += [bar(0.09, 0.05, "z", 0.13 * np.cos(a), 0.13 * np.sin(a), 0.025) for a in np.radians([0, 120, 240])]
    return Thing(name, tuple(parts), at)


def cargo_bag(name: str = "cargo bag", *, at: Floats) -> Thing:
    """A soft cargo transfer bag standing on the table, its broad side facing +x; `at` (4, 4) is its place."""
    w, d, h = CARGO_BAG
    seam = 0.025
    parts = [
        box((w, d - 2 * seam, h - 2 * seam), z=h / 2),
        box((w - 2 * seam, d, h - 2 * seam), z=h / 2),
        box((w - 2 * seam, d - 2 * seam, h), z=h / 2),
        box((w + 0.03, d - 0.14, h - 0.16), z=h / 2),  # a full bag bulges
        *(box((w + 0.045, 0.04, h - 0.06), y=y, z=h / 2) for y in (-0.12, 0.12)),  # straps
        bar(0.03, 0.20, "y", 0, 0, h + 0.05),  # handle
        *(box((0.02, 0.02, 0.06), 0, y, h + 0.03) for y in (-0.09, 0.09)),
    ]
    return Thing(name, tuple(parts), at)


def crate(name: str = "crate", *, at: Floats) -> Thing:
    """An open crate with a rim and four corner posts; `at` (4, 4) is its place on the table."""
    w, d, h = CRATE
    wall = 0.02
    sides: list[Solid] = [box((wall, d - 0.02, h - 0.03), s * (w / 2 - wall), 0, (h - 0.03) / 2) for s in (-1, 1)]
    sides += [box((w - 0.02, wall, h - 0.03), 0, s * (d / 2 - wall), (h - 0.03) / 2) for s in (-1, 1)]
    rim: list[Solid] = [box((0.04, d, 0.03), s * (w / 2 - 0.02), 0, h - 0.015) for s in (-1, 1)]
    rim += [box((w, 0.04, 0.03), 0, s * (d / 2 - 0.02), h - 0.015) for s in (-1, 1)]
    corners = [box((0.04, 0.04, h), i * (w / 2 - 0.02), j * (d / 2 - 0.02), h / 2) for i in (-1, 1) for j in (-1, 1)]
    return Thing(name, (*sides, *rim, *corners, box((w - 0.02, d - 0.02, 0.02), z=0.03)), at)


def dock() -> Thing:
    """The docking station: a block with two berths side by side, on a stand."""
    w, d, h = DOCK
    berths = [box((0.02, 0.22, 0.22), w / 2 + 0.01, s * d / 4, 0) for s in (-1, 1)]
    foot = box((0.12, 0.5, DOCK_PLACE[2] - h / 2), z=-(DOCK_PLACE[2] + h / 2) / 2)
    return Thing("dock", (box(DOCK), *berths, foot), pose_at(*DOCK_PLACE))


def handrail() -> Thing:
    """The handrail on the wall x = 1: a bar that stands off the wall on two posts."""
    x = 1 - WALL_THICKNESS / 2
    bar_x, post = x - HANDRAIL_STANDOFF + 0.0125, HANDRAIL_STANDOFF - 0.025
    grip = box((0.025, HANDRAIL_LENGTH, HANDRAIL_WIDTH), bar_x)
    posts = [
        box((post, HANDRAIL_WIDTH, HANDRAIL_WIDTH), x - post / 2, s * (HANDRAIL_LENGTH / 2 - 0.03)) for s in (-1, 1)
    ]
    return Thing("handrail", (grip, *posts), pose_at(0, 0, 0.7))


def walls() -> Thing:
    """The six walls that carry the pictures of the space station."""
    along_y, along_x = (WALL_THICKNESS, WALL_WIDTH, WALL_HEIGHT), (WALL_WIDTH, WALL_THICKNESS, WALL_HEIGHT)
    parts = [box(along_y, x, c, WALL_HEIGHT / 2) for x in (-1, 1) for c in WALL_CENTRES]
    parts += [box(along_x, c, -1, WALL_HEIGHT / 2) for c in WALL_CENTRES]
    return Thing("walls", tuple(parts), np.eye(4))


def furnishings() -> Thing:
    """Stand-ins that keep the walls from being bare: seat tracks, rack panels, a vent, a lamp, a cable pipe."""
    face = 1 - WALL_THICKNESS / 2
    parts: list[Solid] = []
    for c in WALL_CENTRES:
        for s in (-1, 1):  # seat tracks up both edges of every wall
            edge = c + s * (WALL_WIDTH / 2 - 0.02)
            parts += [box((0.015, 0.04, WALL_HEIGHT), x * (face - 0.0075), edge, WALL_HEIGHT / 2) for x in (-1, 1)]
            parts.append(box((0.04, 0.015, WALL_HEIGHT), edge, -(face - 0.0075), WALL_HEIGHT / 2))
    parts += [
        box((0.03, 0.60, 0.40), face - 0.015, 0.5, 1.05),  # rack panels
        box((0.03, 0.60, 0.30), face - 0.015, -0.5, 1.25),
        box((0.60, 0.03, 0.40), -0.5, -(face - 0.015), 1.10),
        box((0.25, 0.06, 0.25), 0.35, -(face - 0.03), 0.95),  # vent
        box((0.05, 0.60, 0.08), -(face - 0.025), -0.5, 1.15),  # lamp
        bar(0.05, 0.80, "y", -(face - 0.04), 0.5, 1.20),  # cable pipe
        bar(0.04, 1.20, "z", 0.85, -(face - 0.04), 0.80),
    ]
    return Thing("furnishings", tuple(parts), np.eye(4))


def granite_lab() -> Scene:
    """The empty lab: table, walls, dock, handrail, furnishings, and the hall around it."""
    foot = -TABLE[2] - PEDESTAL[2]
    table = Thing("table", (box(TABLE, z=-TABLE[2] / 2), box(PEDESTAL, z=foot + PEDESTAL[2] / 2)), np.eye(4))
    w, d, h = ROOM
    room: list[Solid] = [box((w, d, 0.1), z=foot - 0.05)]
    room += [box((0.1, d, h), s * (w / 2 + 0.05), 0, foot + h / 2) for s in (-1, 1)]
    room += [box((w, 0.1, h), 0, s * (d / 2 + 0.05), foot + h / 2) for s in (-1, 1)]
    return Scene((table, walls(), dock(), handrail(), furnishings(), Thing("hall", tuple(room), np.eye(4))))
