#!/usr/bin/env python3
"""Writes the URDF files beside it: ur5, ur5e, robotiq_2f85 and both arms with the gripper.

Dimensions are the makers' published ones; shapes are primitives of our own. A collision cylinder
stands for the capsule about its axis. Usage: make_urdf.py (writes into its own folder).
"""
import math
import os

H, PI, TURN = math.pi / 2, math.pi, 2 * math.pi
KNUCKLE = "robotiq_85_left_knuckle_joint"
COLORS = [("steel", "0.62 0.65 0.68 1"), ("blue", "0.35 0.60 0.75 1"),
          ("dark", "0.15 0.15 0.17 1"), ("pad", "0.25 0.25 0.27 1")]

# d1 a2 a3 d4 d5 d6; offsets of upper arm and forearm along their joint axes; masses of the links.
ARMS = {
    "ur5": dict(d=(0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823), upper=0.136,
                fore=0.0165, mass=(3.7, 8.393, 2.33, 1.219, 1.219, 0.1879)),
    "ur5e": dict(d=(0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996), upper=0.138,
                 fore=0.007, mass=(3.761, 8.058, 2.846, 1.37, 1.3, 0.365)),
}


def num(v):
    return repr(round(v, 16) + 0.0)


def nums(*v):
    return " ".join(f"{x:.10g}" if abs(x) not in (H, PI) else num(x) for x in v)


def origin(xyz, rpy=(0, 0, 0)):
    return f'<origin xyz="{nums(*xyz)}" rpy="{nums(*rpy)}"/>'


class Writer:
    def __init__(self, name, note):
        self.lines = ['<?xml version="1.0"?>', f"<!-- {note} Made by make_urdf.py. -->",
                      f'<robot name="{name}">']
        for color, rgba in COLORS:
            self.lines.append(f'  <material name="{color}"><color rgba="{rgba}"/></material>')

    def shape(self, place, geometry, colour, collide):
        out = []
        if colour:
            out.append(f'    <visual>{place}<geometry>{geometry}</geometry>'
                       f'<material name="{colour}"/></visual>')
        if collide:
            out.append(f"    <collision>{place}<geometry>{geometry}</geometry></collision>")
        return out

    def cylinder(self, a, b, radius, colour=None, collide=False):
        """About the segment a..b, which runs along one axis of the link."""
        mid = [(x + y) / 2 for x, y in zip(a, b)]
        span = [abs(x - y) for x, y in zip(a, b)]
        rpy = ((0, H, 0), (H, 0, 0), (0, 0, 0))[span.index(max(span))]
        geometry = f'<cylinder radius="{nums(radius)}" length="{nums(max(span))}"/>'
        return self.shape(origin(mid, rpy), geometry, colour, collide)

    def box(self, centre, size, colour=None, collide=False):
        return self.shape(origin(centre), f'<box size="{nums(*size)}"/>', colour, collide)

    def link(self, name, parts=(), mass=None, com=(0, 0, 0), size=(0.1, 0.1, 0.1)):
        """`size` is the edge lengths of the box whose inertia stands for the link's."""
        if not parts and mass is None:
            self.lines.append(f'  <link name="{name}"/>')
            return
        self.lines.append(f'  <link name="{name}">')
        if mass is not None:
            x, y, z = (s * s for s in size)
            i = [mass / 12 * v for v in (y + z, x + z, x + y)]
            self.lines.append(
                f'    <inertial>{origin(com)}<mass value="{nums(mass)}"/><inertia ixx="{i[0]:.4g}" '
                f'ixy="0" ixz="0" iyy="{i[1]:.4g}" iyz="0" izz="{i[2]:.4g}"/></inertial>')
        for part in parts:
            self.lines.extend(part)
        self.lines.append("  </link>")

    def fixed(self, name, parent, child, xyz=(0, 0, 0), rpy=(0, 0, 0)):
        self.lines.append(f'  <joint name="{name}" type="fixed"><parent link="{parent}"/>'
                          f'<child link="{child}"/>{origin(xyz, rpy)}</joint>')

    def revolute(self, name, parent, child, xyz, rpy, axis, limits, mimic=None):
        lower, upper, effort, speed = limits
        self.lines += [
            f'  <joint name="{name}" type="revolute">',
            f'    <parent link="{parent}"/><child link="{child}"/>{origin(xyz, rpy)}'
            f'<axis xyz="{axis}"/>',
            f'    <limit lower="{num(lower)}" upper="{num(upper)}" effort="{effort}" '
            f'velocity="{num(speed)}"/>']
        if mimic is not None:
            self.lines.append(f'    <mimic joint="{KNUCKLE}" multiplier="{mimic}"/>')
        self.lines.append("  </joint>")

    def save(self, name):
        path = os.path.join(os.path.dirname(os.path.abspath(__file__)), name)
        with open(path, "w") as f:
            f.write("\n".join(self.lines + ["</robot>"]) + "\n")


def arm(w, name):
    p = ARMS[name]
    d1, a2, a3, d4, d5, d6 = p["d"]
    up, fore, mass = p["upper"], p["fore"], p["mass"]
    cyl = w.cylinder
    w.link("base_link")
    w.link("base")
    w.fixed("base_link-base_fixed_joint", "base_link", "base", rpy=(0, 0, PI))
    w.link("base_link_inertia", [cyl((0, 0, 0), (0, 0, 0.038), 0.075, "steel"),
                                 cyl((0, 0, 0), (0, 0, d1 - 0.055), 0.06, "steel"),
                                 cyl((0, 0, 0), (0, 0, 0.03), 0.07, None, True)],
           4.0, (0, 0, 0.02), (0.15, 0.15, 0.04))
    w.fixed("base_link-base_link_inertia", "base_link", "base_link_inertia", rpy=(0, 0, PI))
    w.link("shoulder_link", [cyl((0, 0, -0.07), (0, 0, 0.06), 0.06, "steel"),
                             cyl((0, -0.05, 0), (0, -0.075, 0), 0.055, "blue"),
                             cyl((0, 0, -0.02), (0, 0, 0.02), 0.065, None, True)],
           mass[0], (0, 0, 0), (0.12, 0.12, 0.13))
    w.link("upper_arm_link", [cyl((0, 0, 0.07), (0, 0, 0.19), 0.06, "steel"),
                              cyl((0, 0, up), (a2, 0, up), 0.045, "steel"),
                              cyl((a2, 0, up - 0.075), (a2, 0, up + 0.055), 0.055, "blue"),
                              cyl((0, 0, up), (a2, 0, up), 0.06, None, True),
                              cyl((a2, 0, up - 0.02), (a2, 0, up), 0.058, None, True)],
           mass[1], (a2 / 2, 0, up), (0.425, 0.1, 0.1))
    w.link("forearm_link", [cyl((0, 0, fore - 0.045), (0, 0, fore + 0.05), 0.05, "steel"),
                            cyl((0, 0, fore), (a3, 0, fore), 0.04, "steel"),
                            cyl((a3, 0, fore - 0.035), (a3, 0, d4 - 0.045), 0.04, "blue"),
                            cyl((0, 0, fore - 0.01), (0, 0, fore + 0.015), 0.055, None, True),
                            cyl((0, 0, fore), (a3, 0, fore), 0.045, None, True)],
           mass[2], (a3 / 2, 0, fore), (0.392, 0.08, 0.08))
    for i, n in ((3, "wrist_1_link"), (4, "wrist_2_link")):
        y = -1 if i == 3 else 1
        w.link(n, [cyl((0, 0, -0.055), (0, 0, 0.035), 0.038, "steel"),
                   cyl((0, 0.03 * y, 0), (0, 0.055 * y, 0), 0.037, "blue"),
                   cyl((0, 0, -0.06), (0, 0, 0), 0.045, None, True)],
               mass[i], (0, 0, -0.01), (0.08, 0.08, 0.1))
    w.link("wrist_3_link", [cyl((0, 0, -0.04), (0, 0, 0), 0.0375, "steel"),
                            cyl((0, 0, -0.03), (0, 0, -0.01), 0.04, None, True)],
           mass[5], (0, 0, -0.0229), (0.075, 0.075, 0.04))
    big, small = (-TURN, TURN, 150, PI), (-TURN, TURN, 28, PI)
    z = "0 0 1"
    rev = w.revolute
    rev("shoulder_pan_joint", "base_link_inertia", "shoulder_link", (0, 0, d1), (0, 0, 0), z, big)
    rev("shoulder_lift_joint", "shoulder_link", "upper_arm_link", (0, 0, 0), (H, 0, 0), z, big)
    rev("elbow_joint", "upper_arm_link", "forearm_link", (a2, 0, 0), (0, 0, 0), z,
        (-PI, PI, 150, PI))
    rev("wrist_1_joint", "forearm_link", "wrist_1_link", (a3, 0, d4), (0, 0, 0), z, small)
    rev("wrist_2_joint", "wrist_1_link", "wrist_2_link", (0, -d5, 0), (H, 0, 0), z, small)
    rev("wrist_3_joint", "wrist_2_link", "wrist_3_link", (0, d6, 0), (H, PI, PI), z, small)
    w.link("flange")
    w.fixed("wrist_3-flange", "wrist_3_link", "flange", rpy=(0, -H, -H))
    w.link("tool0")
    w.fixed("flange-tool0", "flange", "tool0", rpy=(H, 0, H))


def gripper(w):
    """x is the closing axis, z the approach."""
    base = "robotiq_85_base_link"
    w.link(base, [w.cylinder((0, 0, 0), (0, 0, 0.03), 0.037, "dark"),
                  w.box((0, 0, 0.06), (0.10, 0.06, 0.06), "dark"),
                  w.cylinder((0, 0, 0.03), (0, 0, 0.06), 0.045, None, True),
                  w.box((0, 0, 0.06), (0.10, 0.06, 0.06), None, True)],
           0.64, (0, 0, 0.04), (0.1, 0.06, 0.09))
    for side, s in (("left", 1), ("right", -1)):
        link = {n: f"robotiq_85_{side}_{n}" for n in
                ("knuckle", "finger", "inner_knuckle", "finger_tip")}
        w.link(link["knuckle"] + "_link",
               [w.box((0.0158 * s, 0, -0.002), (0.038, 0.012, 0.012), "dark", True)],
               0.02, (0.0158 * s, 0, 0), (0.04, 0.012, 0.012))
        w.link(link["finger"] + "_link",
               [w.box((0.003 * s, 0, 0.023), (0.012, 0.02, 0.05), "dark"),
                w.box((0.003 * s, 0, 0.023), (0.014, 0.022, 0.05), None, True)],
               0.03, (0.003 * s, 0, 0.023), (0.014, 0.022, 0.05))
        w.link(link["inner_knuckle"] + "_link",
               [w.box((0.017 * s, 0, 0.02), (0.012, 0.012, 0.05), "dark", True)],
               0.02, (0.017 * s, 0, 0.02), (0.04, 0.012, 0.05))
        w.link(link["finger_tip"] + "_link",
               [w.box((-0.01026 * s, 0, 0.02), (0.02, 0.02, 0.02), "dark", True),
                w.box((-0.02026 * s, 0, 0.031), (0.01, 0.022, 0.04), "pad", True)],
               0.03, (-0.018 * s, 0, 0.03), (0.02, 0.022, 0.04))
        closing = (0, 0.7929) if s == 1 else (-0.7929, 0)
        opening = (-0.7929, 0) if s == 1 else (0, 0.7929)
        rev, axis = w.revolute, "0 -1 0"
        rev(link["knuckle"] + "_joint", base, link["knuckle"] + "_link",
            (0.03060114 * s, 0, 0.05490452), (0, 0, 0), axis, (*closing, 50, 0.5),
            None if s == 1 else -1)
        w.fixed(link["finger"] + "_joint", link["knuckle"] + "_link", link["finger"] + "_link",
                (0.03152616 * s, 0, -0.00376347))
        rev(link["inner_knuckle"] + "_joint", base, link["inner_knuckle"] + "_link",
            (0.0127 * s, 0, 0.06142), (0, 0, 0), axis, (*closing, 50, 0.5), s)
        rev(link["finger_tip"] + "_joint", link["finger"] + "_link", link["finger_tip"] + "_link",
            (0.00563134 * s, 0, 0.04718515), (0, 0, 0), axis, (*opening, 50, 0.5), -s)


FRAMES = ("Frames: base_link (REP-103), base (the UR controller's, turned by pi about z), flange, "
          "tool0")
for name in ARMS:
    title = "UR5 (CB3)" if name == "ur5" else "UR5e"
    w = Writer(name, f"{title} from published dimensions; primitives only. {FRAMES}.")
    arm(w, name)
    w.save(f"{name}.urdf")
    w = Writer(f"{name}_2f85", f"{title} with a Robotiq 2F-85; primitives only. {FRAMES}, and tcp "
               "between the pads, 0.150 m along tool0 z; y of tool0 and tcp is the fingers' "
               "closing axis.")
    arm(w, name)
    w.link("tcp")
    w.fixed("tool0-tcp", "tool0", "tcp", (0, 0, 0.150))
    gripper(w)
    w.fixed("tool0-robotiq_85_base", "tool0", "robotiq_85_base_link", rpy=(0, 0, H))
    w.save(f"{name}_2f85.urdf")
w = Writer("robotiq_2f85", "Robotiq 2F-85; primitives only. The left knuckle is the one actuated "
           "joint, all others mimic it.")
gripper(w)
w.save("robotiq_2f85.urdf")
