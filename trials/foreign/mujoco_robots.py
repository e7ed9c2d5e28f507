"""Robots with known causes, played in MuJoCo: data set folders, and their labels outside them.

    python mujoco_robots.py OUT --robots 60 --seed 1 [--kind null] [--gaits 6,8]

writes OUT/cases/r0000/{dataset.toml, *.csv} and OUT/labels.json (with its SHA-256). Bodies are convex hulls of half-spheres; contacts, friction
cone, integrator are MuJoCo's, their parameters drawn for each robot. Goes on where it stopped.
"""

import ctypes
import math
from pathlib import Path

import mujoco
import numpy as np

import recording
import robots as R
import suite
from geometry import HALVES, ORIGINS, PLACES, half_points, joints_at_home


def library(folder):
    """The C part, compiled against the installed MuJoCo."""
    home = Path(mujoco.__file__).parent
    so = next(home.glob("libmujoco.so*"))
    return suite.compiled(folder, "mujoco_play", [f"-I{home}/include"], [so, f"-Wl,-rpath,{home}"])


def model_xml(split, points):
    """MJCF of the meta-module along x; `split`: the connector between the modules has three hinges."""
    axes, anchors = joints_at_home()
    text = lambda v: " ".join(f"{c:.9g}" for c in np.ravel(v))
    meshes = "".join(f'<mesh name="h{h}" inertia="convex" vertex="{text(half_points(h, points))}"/>' for h in range(8))

    def geom(h, b):
        kind, to = {0: (1, 2), 1: (1, 2), 5: (2, 1), 6: (2, 1)}.get(b, (4, 0))
        return f'<geom name="g{h}" type="mesh" mesh="h{h}" pos="{text(PLACES[h // 2] - ORIGINS[b])}" mass="{R.HALF_KG}" contype="{kind}" conaffinity="{to}"/>'

    body, tail = "", ""
    for b in range(7):
        at = ORIGINS[b] - (ORIGINS[b - 1] if b else 0) + (np.array([0, 0, 0.2]) if b == 0 else 0)
        joint = '<freejoint name="base"/>'
        if b:
            joint = f'<joint name="j{b - 1}" axis="{text(axes[b - 1])}" pos="{text(anchors[b - 1] - ORIGINS[b])}" armature="0.001"/>'
        inner = geom(HALVES[b][0], b)
        if b == 3:
            inner += '<site name="imu"/>'
            if split:
                hinges = "".join(f'<joint name="c{k}" axis="{text(np.eye(3)[k])}" armature="0.0005"/>' for k in range(3))
                inner += f'<body name="c">{hinges}{geom(4, b)}'
                tail += "</body>"
            else:
                inner += geom(4, b)
        body += f'<body name="b{b}" pos="{text(at)}">{joint}{inner}'
        tail += "</body>"
    # The servo is a dry tendon to a flywheel that turns at the speed asked for: a speed imposed with a limited torque.
    wheels = "".join(
        f'<body pos="0 {k} -5"><joint name="w{k}" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1e6 1e6 1e6"/></body>' for k in range(6))
    motors = "".join(
        f'<fixed name="m{k}" frictionloss="1" solreffriction="0.002 1" solimpfriction="0.9999 0.9999 0.001"><joint joint="j{k}" coef="1"/>'
        f'<joint joint="w{k}" coef="-1"/></fixed>' for k in range(6))
    pairs = "".join(f'<pair geom1="ground" geom2="g{h}" condim="4"/>' for h in range(8))
    return (f'<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/><asset>{meshes}</asset><worldbody>'
            f'<geom name="ground" type="plane" size="0 0 1" contype="0" conaffinity="0"/>{body}{tail}{wheels}</worldbody><contact>{pairs}</contact>'
            f'<tendon>{motors}</tendon><sensor><gyro site="imu"/><accelerometer site="imu"/></sensor></mujoco>')


class Mujoco:
    """MuJoCo: models compiled once by their structure, and the masses of half-spheres of 1 kg."""

    name = "mujoco"

    def __init__(self, folder):
        self.lib, self.models, self.parts = library(folder), {}, None

    def contact(self, rng):
        """Contact parameters of a robot."""
        return {"cone": "elliptic" if rng.random() < 0.7 else "pyramidal", "impratio": float(rng.choice([1, 1, 3, 10, 30])), "dmin": float(rng.uniform(0.85, 0.97)),
                "width": R.log_uniform(rng, 3e-4, 2e-3, False), "torsion_m": 0.0 if rng.random() < 0.6 else R.log_uniform(rng, 1e-4, 8e-4, False), "points": 1500}

    def other_contacts(self, contact):
        """Those of two other simulators: harder and softer."""
        return contact | {"impratio": 30.0, "cone": "elliptic", "torsion_m": 0.0}, contact | {"impratio": 1.0, "cone": "pyramidal", "dmin": 0.9}

    def play(self, runs, seconds, rate, push, pushes):
        """Logs of the first of `runs`, and of the others, which begin again where it is one second in two; None where it flies apart.
        A run: (robot, contact, schedules, start angles, yaw)."""
        made, keep = [], []
        for robot, contact, schedules, *_ in runs:
            p, data, alive = player(robot, build(self, robot, contact), schedules)
            made.append(p)
            keep.append((data, alive))
        robot, _, _, start, yaw = runs[0]
        place(keep[0][1][3], keep[0][0], made[0], start, yaw - robot.anisotropy[1])
        rows, others = int(seconds * rate), len(runs) - 1
        log, other_logs = np.zeros((rows, recording.ROWS)), np.zeros((max(others, 1), rows, recording.ROWS))
        pointers = (ctypes.c_void_p * max(others, 1))(*[ctypes.addressof(p) for p in made[1:]])
        push_pointers = (ctypes.c_void_p * max(others, 1))(*[p.ctypes.data for p in pushes])
        at = lambda a: a.ctypes.data_as(ctypes.c_void_p)
        failed = self.lib.play(ctypes.byref(made[0]), ctypes.c_double(suite.SETTLE_S), ctypes.c_double(1 / rate), ctypes.c_int(rows), at(push), at(log),
                               pointers, push_pointers, ctypes.c_int(others), at(other_logs))
        return None if failed else (log, other_logs[:others])

    def plain(self, split, points):
        """The nominal model, compiled once."""
        key = (split, points)
        if key not in self.models:
            self.models[key] = mujoco.MjModel.from_xml_string(model_xml(split, points))
        return self.models[key]

    def half(self, h):
        """Centre of mass and inertia about it of a half-sphere of 1 kg, from its cube's centre."""
        if self.parts is None:
            self.parts = []
            meshes = "".join(f'<mesh name="h{k}" inertia="convex" vertex="{" ".join(f"{c:.9g}" for c in half_points(k, 1500).ravel())}"/>' for k in range(8))
            bodies = "".join(f'<body><freejoint/><geom type="mesh" mesh="h{k}" mass="1"/></body>' for k in range(8))
            m = mujoco.MjModel.from_xml_string(f"<mujoco><asset>{meshes}</asset><worldbody>{bodies}</worldbody></mujoco>")
            for k in range(1, 9):
                r = np.zeros(9)
                mujoco.mju_quat2Mat(r, m.body_iquat[k])
                r = r.reshape(3, 3)
                self.parts.append((m.body_ipos[k].copy(), r @ np.diag(m.body_inertia[k]) @ r.T))
        return self.parts[h]


def set_body(model, b, parts):
    """Masses of a body: (kg, centre, inertia about it)."""
    total = sum(p[0] for p in parts)
    centre = sum(p[0] * p[1] for p in parts) / total
    inertia = np.zeros((3, 3))
    for kg, at, own in parts:
        d = at - centre
        inertia += own + kg * (d @ d * np.eye(3) - np.outer(d, d))
    size, axes = np.linalg.eigh(inertia)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    q = np.zeros(4)
    mujoco.mju_mat2Quat(q, axes.ravel())
    model.body_mass[b], model.body_ipos[b], model.body_iquat[b], model.body_inertia[b] = total, centre, q, size


def build(engine, robot, contact):
    """The model of a robot."""
    split = robot.robot[R.ROBOT["LINK_STIFFNESS"]] > 0
    model = mujoco.MjModel.__copy__(engine.plain(split, contact["points"]))
    name = lambda kind, n: mujoco.mj_name2id(model, kind, n)
    body = mujoco.mjtObj.mjOBJ_BODY
    for b in range(7):
        parts = []
        for h in HALVES[b]:
            at, inertia = engine.half(h)
            kg = robot.halves_kg[h]
            parts.append((h, (kg, at + PLACES[h // 2] - ORIGINS[b] + (robot.com_m if b == 3 else 0), kg * inertia)))
        own = [p for h, p in parts if not (split and h == 4)]
        own += [(kg, np.array(at) + (0 if b == 3 else PLACES[HALVES[b][0] // 2] - ORIGINS[b]), 1e-5 * kg * np.eye(3)) for w, kg, at in robot.weights if w == b and any(at)]
        if any(w == b and not any(at) for w, _, at in robot.weights):
            more = sum(kg for w, kg, at in robot.weights if w == b and not any(at))
            kg, at, inertia = own[0]
            own[0] = (kg + more, at, inertia * (kg + more) / kg)
        set_body(model, name(body, f"b{b}"), own)
        if b == 3 and split:
            set_body(model, name(body, "c"), [p for h, p in parts if h == 4])
    for k in range(6):
        model.dof_armature[model.jnt_dofadr[name(mujoco.mjtObj.mjOBJ_JOINT, f"j{k}")]] = 0.001 + robot.armature[k]
    z = -math.log(robot.bounce)
    damping = z / math.sqrt(math.pi**2 + z * z)
    constant = max(1.0 / (robot.contact_rad_s * damping), 0.0021)
    across = robot.anisotropy[0]
    # Along `direction` friction is the coefficient, across it that times the ratio; tangents of a contact with the
    # plane are y, then x.
    model.pair_friction[:, 0], model.pair_friction[:, 1] = robot.friction * across, robot.friction
    model.pair_friction[:, 2] = max(robot.torsion_m, contact["torsion_m"])
    model.pair_friction[:, 3:] = 1e-5
    model.pair_dim[:] = 4 if robot.torsion_m > 0 or contact["torsion_m"] > 0 else 3
    model.pair_solref[:] = (constant, damping)
    model.pair_solimp[:] = (contact["dmin"], 0.99, contact["width"], 0.5, 2)
    model.opt.timestep = 0.0005 if robot.loose() else 0.001
    model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC if contact["cone"] == "elliptic" else mujoco.mjtCone.mjCONE_PYRAMIDAL
    model.opt.impratio = contact["impratio"]
    model.opt.iterations, model.opt.tolerance = 30, 1e-8
    roll, pitch = robot.slope
    g = 9.80665 * np.array([math.sin(pitch), -math.sin(roll) * math.cos(pitch), -math.cos(roll) * math.cos(pitch)])
    # The ground's own axes are the engine's: the world is turned instead.
    c, s = math.cos(-robot.anisotropy[1]), math.sin(-robot.anisotropy[1])
    model.opt.gravity[:] = (c * g[0] - s * g[1], s * g[0] + c * g[1], g[2])
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


class Schedule(ctypes.Structure):
    _fields_ = [("count", ctypes.c_int), ("due", ctypes.c_void_p), ("value", ctypes.c_void_p)]


class Player(ctypes.Structure):
    _fields_ = [("model", ctypes.c_void_p), ("data", ctypes.c_void_p), ("angle", ctypes.c_int * 6), ("speed", ctypes.c_int * 6), ("wheel", ctypes.c_int * 6),
                ("tendon", ctypes.c_int * 6), ("link_angle", ctypes.c_int * 3), ("link_speed", ctypes.c_int * 3), ("base", ctypes.c_int), ("gyro", ctypes.c_int),
                ("accel", ctypes.c_int), ("joints", ctypes.c_void_p), ("robot", ctypes.c_void_p), ("schedule", Schedule * 6), ("turn", ctypes.c_double * 4)]


def player(robot, model, schedules):
    """What the C part is given of a robot; keeps alive what it points to."""
    data = mujoco.MjData(model)
    p = Player(model._address, data._address)
    ident = lambda kind, n: mujoco.mj_name2id(model, kind, n)
    joint = mujoco.mjtObj.mjOBJ_JOINT
    for k in range(6):
        j, w = ident(joint, f"j{k}"), ident(joint, f"w{k}")
        p.angle[k], p.speed[k], p.wheel[k] = model.jnt_qposadr[j], model.jnt_dofadr[j], model.jnt_dofadr[w]
        p.tendon[k] = ident(mujoco.mjtObj.mjOBJ_TENDON, f"m{k}")
        due, wire = schedules[k]
        p.schedule[k] = Schedule(len(due), due.ctypes.data, wire.ctypes.data)
    for k in range(3):
        c = ident(joint, f"c{k}")
        p.link_angle[k] = model.jnt_qposadr[c] if c >= 0 else -1
        p.link_speed[k] = model.jnt_dofadr[c] if c >= 0 else -1
    p.base, p.gyro, p.accel = ident(mujoco.mjtObj.mjOBJ_BODY, "b3"), 0, 3
    joints, own = np.ascontiguousarray(robot.joints), np.ascontiguousarray(robot.robot)
    p.joints, p.robot = joints.ctypes.data, own.ctypes.data
    half = 0.5 * robot.anisotropy[1]
    p.turn[:] = (math.cos(half), 0, 0, math.sin(half))
    return p, data, (joints, own, schedules, model)


def place(model, data, p, start, yaw):
    """The robot at its start, just above the ground."""
    for j in range(6):
        data.qpos[p.angle[j]] = start[j]
    data.qpos[3], data.qpos[6] = math.cos(yaw / 2), math.sin(yaw / 2)
    mujoco.mj_forward(model, data)
    data.qpos[2] -= lowest(model, data) - 0.002


def lowest(model, data):
    """Height of the lowest point of all half-spheres."""
    low = math.inf
    for h in range(8):
        g = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, f"g{h}")
        mesh = model.geom_dataid[g]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        z = model.mesh_vert[first: first + count] @ data.geom_xmat[g].reshape(3, 3)[2] + data.geom_xpos[g][2]
        low = min(low, z.min())
    return low


if __name__ == "__main__":
    suite.main(__doc__, Mujoco)
