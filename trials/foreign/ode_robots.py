"""Robots with known causes, played in ODE: data set folders, and their labels outside them.

    python ode_robots.py OUT --robots 60 --seed 1 [--kind null] [--gaits 6,8]

As mujoco_robots.py, which says what is written. Needs a C compiler and ODE (Debian: libode-dev). A reflected inertia is a rotor behind a stiff
gear here: ODE has no other.
"""

import ctypes
import math

import numpy as np

import recording
import robots as R
import suite
from geometry import BALL_M, HALVES, ORIGINS, PLACES, half_points, half_solid, joints_at_home, quaternion, stand

BODIES, HALF_COUNT = 8, 8
STEP_S = 0.001
D = ctypes.c_double


class Schedule(ctypes.Structure):
    _fields_ = [("count", ctypes.c_int), ("due", ctypes.c_void_p), ("value", ctypes.c_void_p)]


class Player(ctypes.Structure):
    _fields_ = [
        ("bodies", ctypes.c_int), ("quick", ctypes.c_int), ("mass", D * BODIES), ("inertia", D * 6 * BODIES), ("com", D * 3 * BODIES), ("origin", D * 3 * BODIES),
        ("place", D * 3 * BODIES), ("attitude", D * 4 * BODIES), ("axis", D * 3 * 6), ("anchor", D * 3 * 6), ("child", ctypes.c_int * 6), ("parent", ctypes.c_int * 6),
        ("half_body", ctypes.c_int * HALF_COUNT), ("points", ctypes.c_int * HALF_COUNT), ("point", ctypes.c_void_p * HALF_COUNT), ("cube", D * 3 * 2), ("ball", D),
        ("split", D * 3), ("gravity", D * 3), ("friction", D * 2), ("direction", D), ("torsion", D), ("bounce", D), ("stiffness", D), ("damping", D), ("step", D),
        ("joints", ctypes.c_void_p), ("robot", ctypes.c_void_p), ("schedule", Schedule * 6)]


def put(array, values):
    """Copies numbers into an array of the C part."""
    for i, v in enumerate(values):
        if hasattr(array[i], "__len__"):
            put(array[i], v)
        else:
            array[i] = v


class Ode:
    """ODE: the surface points and masses of half-spheres, made once."""

    name = "ode"

    def __init__(self, folder):
        self.lib = suite.compiled(folder, "ode_play", [], ["-lode"])
        self.solid = [half_solid(h) for h in range(HALF_COUNT)]
        self.surface = {}

    def contact(self, rng):
        """Contact parameters of a robot."""
        return {"quick": int(rng.random() < 0.5), "zeta": float(rng.uniform(0.4, 1.2)), "points": int(rng.choice([400, 700, 1000]))}

    def other_contacts(self, contact):
        """Those of two other simulators: another solver, and rougher bodies."""
        return contact | {"quick": 1 - contact["quick"], "zeta": 0.5}, contact | {"points": 300, "zeta": 1.2}

    def parts(self, robot, b):
        """Masses of body `b`: half-sphere or none, kg, centre in the body's frame, inertia about it."""
        out = []
        shift = robot.com_m if b == 3 else 0
        for h in HALVES[b]:
            at, inertia = self.solid[h]
            kg = robot.halves_kg[h] + (sum(m for w, m, p in robot.weights if w == b and not any(p)) if h == HALVES[b][0] else 0)
            out.append((h, kg, at + PLACES[h // 2] - ORIGINS[b] + shift, kg * inertia))
        frame = 0 if b == 3 else PLACES[HALVES[b][0] // 2] - ORIGINS[b]
        return out + [(-1, m, np.array(p) + frame, 1e-5 * m * np.eye(3)) for w, m, p in robot.weights if w == b and any(p)]

    def player(self, robot, contact, schedules, start, yaw):
        """What the C part is given of a robot; keeps alive what it points to."""
        robot = geared(robot)
        p = Player()
        split = robot.robot[R.ROBOT["LINK_STIFFNESS"]] > 0
        p.bodies, p.quick, p.ball = 8 if split else 7, contact["quick"], BALL_M
        places, rotations = stand(start, yaw)
        alive = [schedules]
        bodies = [self.parts(robot, b) for b in range(7)]
        if split:
            bodies.append([x for x in bodies[3] if x[0] == 4])
            bodies[3] = [x for x in bodies[3] if x[0] != 4]
        for b, parts in enumerate(bodies):
            frame = min(b, 6) if b < 7 else 3
            kg, com, inertia = gathered(parts)
            p.mass[b] = kg
            put(p.inertia[b], [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]])
            put(p.com[b], com)
            put(p.origin[b], ORIGINS[frame])
            put(p.attitude[b], quaternion(rotations[frame]))
            put(p.place[b], places[frame])
        axes, anchors = joints_at_home()
        put(p.axis, axes)
        put(p.anchor, anchors)
        put(p.child, range(1, 7))
        put(p.parent, [7 if split and k == 3 else k for k in range(6)])
        put(p.split, ORIGINS[3])
        put(p.cube, [PLACES[0] - ORIGINS[1], PLACES[3] - ORIGINS[5]])
        low = self.surfaces(p, contact["points"], split, places, rotations, alive)
        for b in range(p.bodies):
            p.place[b][2] += 0.002 - low
        ground(p, robot, contact)
        joints, own = np.ascontiguousarray(robot.joints), np.ascontiguousarray(robot.robot)
        p.joints, p.robot = joints.ctypes.data, own.ctypes.data
        for k, (due, wire) in enumerate(schedules):
            p.schedule[k] = Schedule(len(due), due.ctypes.data, wire.ctypes.data)
        return p, alive + [joints, own]

    def surfaces(self, p, count, split, places, rotations, alive):
        """Gives the half-spheres their points; returns the height of the lowest."""
        low = math.inf
        for b in range(7):
            for h in HALVES[b]:
                if (h, count) not in self.surface:
                    self.surface[h, count] = np.ascontiguousarray(half_points(h, count)[:-1] + PLACES[h // 2] - ORIGINS[b])
                points = self.surface[h, count]
                alive.append(points)
                p.half_body[h] = 7 if split and h == 4 else b
                p.points[h], p.point[h] = len(points), points.ctypes.data
                low = min(low, (points @ rotations[b].T + places[b])[:, 2].min())
        return low

    def play(self, runs, seconds, rate, push, pushes):
        """As of mujoco_robots.Mujoco."""
        made = [self.player(*run) for run in runs]
        rows, others = int(seconds * rate), len(runs) - 1
        log, other_logs = np.zeros((rows, recording.ROWS)), np.zeros((max(others, 1), rows, recording.ROWS))
        pointers = (ctypes.c_void_p * max(others, 1))(*[ctypes.addressof(p) for p, _ in made[1:]])
        push_pointers = (ctypes.c_void_p * max(others, 1))(*[p.ctypes.data for p in pushes])
        at = lambda a: a.ctypes.data_as(ctypes.c_void_p)
        failed = self.lib.play(ctypes.byref(made[0][0]), D(suite.SETTLE_S), D(1 / rate), ctypes.c_int(rows), at(push), at(log), pointers, push_pointers,
                               ctypes.c_int(others), at(other_logs))
        return None if failed else (log, other_logs[:others])


def gathered(parts):
    """Mass, centre and inertia about it of several parts."""
    total = sum(x[1] for x in parts)
    centre = sum(x[1] * x[2] for x in parts) / total
    inertia = np.zeros((3, 3))
    for _, kg, at, own in parts:
        d = at - centre
        inertia += own + kg * (d @ d * np.eye(3) - np.outer(d, d))
    return total, centre, inertia


def geared(robot):
    """A reflected inertia as a rotor behind a stiff gear."""
    robot = robot.copy()
    for k in range(6):
        if robot.armature[k] > 0:
            if robot.joints[k, R.JOINT["STIFFNESS"]] == 0 and robot.joints[k, R.JOINT["PLAY"]] == 0:
                robot.joints[k, R.JOINT["STIFFNESS"]] = 1500
            robot.joints[k, R.JOINT["ROTOR"]] = robot.armature[k]
    return robot


def ground(p, robot, contact):
    """Contacts and gravity."""
    across, direction = robot.anisotropy
    put(p.friction, [robot.friction, robot.friction * across])
    p.direction, p.torsion, p.bounce = direction, robot.torsion_m, robot.bounce
    # A third of the robot stands on a place, of some four points.
    kg = robot.halves_kg.sum() / 12
    p.stiffness = robot.contact_rad_s**2 * kg
    p.damping = 2 * contact["zeta"] * robot.contact_rad_s * kg
    p.step = STEP_S / 2 if robot.loose() else STEP_S
    roll, pitch = robot.slope
    put(p.gravity, 9.80665 * np.array([math.sin(pitch), -math.sin(roll) * math.cos(pitch), -math.cos(roll) * math.cos(pitch)]))


if __name__ == "__main__":
    suite.main(__doc__, Ode)
