"""The meta-module on the ground, played by MuJoCo from the design's geometry: data set folders with known causes.

Bodies are convex hulls of half-spheres, contacts, friction cone, integrator and joint friction are MuJoCo's; the servo law (Table II) is
written out below. Nothing is shared with the project's own simulator or emulated robot.
"""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

EDGE_M, BALL_M, HALF_KG = 0.110, 0.062, 0.325
DIAGONAL = np.ones(3) / math.sqrt(3.0)
# Hand-tuned values of Table II: intra-cube joints 0 2 3 5, inter-cube joints 1 4.
INTER = (1, 4)
SPEED = [1.5 if k in INTER else 2.5 for k in range(6)]
TORQUE = [3.2 if k in INTER else 4.8 for k in range(6)]
GAIN = 10.0
# Effort per ampere at the output: 12 V over the no-load speed of Table I.
EFFORT_PER_A = [12.0 / (2.032 if k in INTER else 2.786) for k in range(6)]
WINDING_OHM = [4.09 if k in INTER else 1.9 for k in range(6)]


@dataclass
class Robot:
    """What the robot really is."""

    friction: float = 1.0
    mass: float = 1.0
    slope: tuple = (0.0, 0.0)
    com: tuple = (0.0, 0.0, 0.0)
    # Centre of mass of the middle body alone, no weight added, m.
    middle: tuple = (0.0, 0.0, 0.0)
    torsional: float = 0.0
    # Friction across a direction over that along it, and the direction from x, rad.
    anisotropy: tuple = (1.0, 0.0)
    # MuJoCo's contact: time constant (s) and damping ratio, or stiffness and damping where both are negative.
    solref: tuple = (0.01, 0.7)
    impratio: float = 5.0
    cone: str = "elliptic"
    coulomb: dict = field(default_factory=dict)
    viscous: dict = field(default_factory=dict)
    latency: dict = field(default_factory=dict)
    offset: dict = field(default_factory=dict)
    scale: dict = field(default_factory=dict)
    torque: dict = field(default_factory=dict)
    speed: dict = field(default_factory=dict)
    gain: dict = field(default_factory=dict)
    order: tuple = (0, 1, 2, 3, 4, 5)
    loss: dict = field(default_factory=dict)
    # Points that a whole ball's surface is made of: at 1500 facets leave the ball by 0.06 mm, at 260 by 0.4 mm, and the robot rolls from facet to facet.
    points: int = 1500


@dataclass
class Case:
    """One data set folder and its label."""

    name: str
    robot: Robot = field(default_factory=Robot)
    truth: tuple = ()
    gaits: int = 6
    repeats: int = 2
    seconds: float = 12.0
    lengths: tuple = ()
    columns: tuple = ("applied", "position", "velocity", "current", "duty", "bus_v")
    rate_hz: float = 40.0
    base: bool = True
    imu: bool = False
    # Amplitudes and offsets over those of the plain gaits, and the first gait's number.
    vigour: float = 1.0
    first: int = 0


def turn_x(angle):
    """Rotation about x."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def half_points(diagonal, distal, n):
    """Surface points of a half-sphere: ball about the cube's centre, cut by the cube's faces and by the diagonal plane; `n` on a whole ball."""
    sign = 1.0 if distal else -1.0
    out = [np.zeros(3)]

    def reach(v):
        return min(BALL_M, 0.5 * EDGE_M / max(abs(v)))

    for k in range(n):
        z = 1.0 - 2.0 * (k + 0.5) / n
        a, r = 2.399963 * k, math.sqrt(1.0 - z * z)
        v = np.array([r * math.cos(a), r * math.sin(a), z])
        if sign * (v @ diagonal) > 0.0:
            out.append(reach(v) * v)
    # Rims of the faces' discs, on which a robot stands and turns.
    flat = 0.5 * EDGE_M
    rim = math.sqrt(BALL_M**2 - flat**2)
    for axis in range(3):
        for face in (-flat, flat):
            for k in range(72):
                v = np.full(3, face)
                v[(axis + 1) % 3] = rim * math.cos(k * math.pi / 36)
                v[(axis + 2) % 3] = rim * math.sin(k * math.pi / 36)
                if sign * (v @ diagonal) > 0.0:
                    out.append(v)
    u = np.cross(diagonal, [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    w = np.cross(diagonal, u)
    for k in range(96):
        v = math.cos(k * math.pi / 48) * u + math.sin(k * math.pi / 48) * w
        out.append(reach(v) * v)
    return np.array(out)


def model_xml(robot):
    """MJCF of the meta-module lying along x."""
    twisted = turn_x(math.pi / 2) @ DIAGONAL
    axes = [DIAGONAL, np.array([1.0, 0, 0]), DIAGONAL, twisted, np.array([1.0, 0, 0]), twisted]
    cube = [np.array([k * EDGE_M, 0, 0]) for k in range(4)]
    origins = [cube[0], cube[0], cube[1], 0.5 * (cube[1] + cube[2]), cube[2], cube[3], cube[3]]
    anchors = [cube[0], 0.5 * (cube[0] + cube[1]), cube[1], cube[2], 0.5 * (cube[2] + cube[3]), cube[3]]
    halves = [[(0, False)], [(0, True)], [(1, False)], [(1, True), (2, False)], [(2, True)], [(3, False)], [(3, True)]]
    mesh, body, tail = [], "", ""
    for b in range(7):
        geoms = ""
        for c, distal in halves[b]:
            name = f"h{c}{int(distal)}"
            points = half_points(DIAGONAL if c < 2 else twisted, distal, robot.points)
            mesh.append(f'<mesh name="{name}" inertia="convex" vertex="{" ".join(f"{x:.6f}" for x in points.ravel())}"/>')
            pos = cube[c] - origins[b]
            kind = "1" if b in (0, 1) else "2" if b in (5, 6) else "4"
            geoms += (
                f'<geom name="g{c}{int(distal)}" type="mesh" mesh="{name}" pos="{pos[0]} {pos[1]} {pos[2]}" mass="{HALF_KG * robot.mass}" contype="{kind}"'
                f' conaffinity="{ {"1": 2, "2": 1, "4": 0}[kind] }"/>'
            )
        if any(robot.com) and b == 3:
            # An unmodelled weight of a fifth of the robot where the whole centre of mass moves by `com`.
            shift = 5.0 * np.array(robot.com)
            geoms += f'<geom type="sphere" size="0.005" mass="{0.2 * 8 * HALF_KG}" pos="{shift[0]} {shift[1]} {shift[2]}" contype="0" conaffinity="0"/>'
        at = origins[b] - (origins[b - 1] if b else np.zeros(3)) + (np.array([0, 0, 0.5 * EDGE_M + 0.001]) if b == 0 else 0)
        joint = '<freejoint name="base"/>'
        if b == 3:
            geoms += '<site name="imu"/>'
        if b:
            a, p = axes[b - 1], anchors[b - 1] - origins[b]
            dry, wet = robot.coulomb.get(b - 1, 0.0), robot.viscous.get(b - 1, 0.0)
            joint = (
                f'<joint name="j{b - 1}" axis="{a[0]} {a[1]} {a[2]}" pos="{p[0]} {p[1]} {p[2]}" armature="0.001" frictionloss="{dry}"'
                f' damping="{wet}" solreffriction="0.004 1" solimpfriction="0.999 0.9999 0.001"/>'
            )
        body += f'<body name="b{b}" pos="{at[0]} {at[1]} {at[2]}">{joint}{geoms}'
        tail += "</body>"
    # The servo is a dry tendon to a flywheel that turns at the speed asked for: a speed imposed with a limited torque.
    wheels = "".join(
        f'<body pos="0 {k} -5"><joint name="w{k}" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1e6 1e6 1e6"/></body>' for k in range(6)
    )
    motors = "".join(
        f'<fixed name="m{k}" frictionloss="{robot.torque.get(k, TORQUE[k])}" solreffriction="0.002 1" solimpfriction="0.9999 0.9999 0.001">'
        f'<joint joint="j{k}" coef="1"/><joint joint="w{k}" coef="-1"/></fixed>'
        for k in range(6)
    )
    roll, pitch = robot.slope
    g = 9.81 * np.array([math.sin(pitch), -math.sin(roll) * math.cos(pitch), -math.cos(roll) * math.cos(pitch)])
    condim = 4 if robot.torsional > 0.0 else 3
    solref = f'solref="{robot.solref[0]} {robot.solref[1]}"'
    ground = (
        f'<geom name="ground" type="plane" size="0 0 1" contype="7" conaffinity="7" friction="{robot.friction} {robot.torsional} 0" condim="{condim}"'
        f' priority="1" {solref}/>'
    )
    pairs, across = "", robot.anisotropy[0]
    if across != 1.0:
        # Tangents of a contact with the plane are the world's y, then x.
        pairs = "".join(
            f'<pair geom1="ground" geom2="g{c}{d}" condim="3" friction="{robot.friction * across} {robot.friction} 0 0 0" {solref}/>'
            for c in range(4) for d in (0, 1)
        )
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast" cone="{robot.cone}" impratio="{robot.impratio}"'
        f' gravity="{g[0]} {g[1]} {g[2]}"/><asset>{"".join(mesh)}</asset><worldbody>{ground}{body}{tail}{wheels}</worldbody>'
        f'<contact>{pairs}</contact><tendon>{motors}</tendon><sensor><gyro site="imu"/><accelerometer site="imu"/></sensor></mujoco>'
    )


def build(robot):
    """The compiled model."""
    model = mujoco.MjModel.from_xml_string(model_xml(robot))
    model.body_ipos[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "b3")] += robot.middle
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def gait(number, seconds, vigour=1.0):
    """Set-points at 20 Hz of a gait: sines with offsets, amplitudes growing as the oscillators' do."""
    rng = np.random.default_rng(7000 + number)
    amplitude = vigour * np.radians(rng.uniform(15, 50, 6))
    offset = vigour * np.radians(rng.uniform(-25, 25, 6))
    phase = rng.uniform(-math.pi, math.pi, 6)
    t = np.arange(0.0, seconds, 0.05)
    grown = 1.0 - np.exp(-2.0 * t)
    return t, offset + (grown * np.sin(2 * math.pi * 0.2 * t + phase[:, None])).T * amplitude


def drive(robot, sent, k, t, rng_loss):
    """Set-point of motor k that is in force at t."""
    times, values = sent
    i = int(np.searchsorted(times, t - robot.latency.get(k, 0.0) + 1e-9, side="right")) - 1
    i = max(i, 0)
    while i > 0 and rng_loss[k][i]:
        i -= 1
    wire = values[i][robot.order[k]]
    return robot.scale.get(k, 1.0) * wire + robot.offset.get(k, 0.0), wire


def torque(data):
    """Torque of the six motors: the forces of the dry tendons."""
    rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON
    out = np.zeros(6)
    out[data.efc_id[rows]] = data.efc_force[rows]
    return out


def play(robot, model, sent, seconds, rng):
    """One run; rows (t, 6 x wire set-point, angle, speed, effort; base; gyro, mean specific force since the row before) at 200 Hz."""
    data = mujoco.MjData(model)
    lost = {k: rng.random(len(sent[0])) < robot.loss.get(k, 0.0) for k in range(6)}
    for k in range(6):
        data.qpos[7 + k] = robot.scale.get(k, 1.0) * sent[1][0][robot.order[k]] + robot.offset.get(k, 0.0)
    # Above the ground at first, then let down: settle for two seconds before the run begins.
    # The ground's own axes are the engine's; what is logged is turned by the direction.
    yaw = 0.05 * rng.normal() - robot.anisotropy[1]
    turn = np.array([math.cos(robot.anisotropy[1] / 2), 0.0, 0.0, math.sin(robot.anisotropy[1] / 2)])
    force = np.zeros(3)
    data.qpos[3], data.qpos[6] = math.cos(yaw / 2), math.sin(yaw / 2)
    mujoco.mj_forward(model, data)
    data.qpos[2] -= min(data.geom_xpos[g][2] for g in range(1, model.ngeom)) - 0.07
    model.geom_friction[0][0] = robot.friction * (1.0 + 0.02 * rng.normal())
    settle, log = 2.0, []
    gain = [robot.gain.get(k, GAIN) for k in range(6)]
    top = [robot.speed.get(k, SPEED[k]) for k in range(6)]
    wire = [0.0] * 6
    target = [0.0] * 6
    for n in range(int((settle + seconds) / 0.001)):
        t = n * 0.001 - settle
        if n % 5 == 0:
            for k in range(6):
                target[k], wire[k] = drive(robot, sent, k, t, lost)
            if t >= -1e-9:
                b = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "b3")
                place, attitude = np.zeros(3), np.zeros(4)
                mujoco.mju_rotVecQuat(place, data.xpos[b], turn)
                mujoco.mju_mulQuat(attitude, turn, data.xquat[b])
                log.append(np.concatenate([[t], wire, data.qpos[7:13], data.qvel[6:12], torque(data), place, attitude, data.sensordata[:3], force / 5]))
            force[:] = 0.0
        q = data.qpos[7:13]
        for k in range(6):
            v = gain[k] * (target[k] - q[k])
            data.qvel[12 + k] = min(max(v, -top[k]), top[k])
        mujoco.mj_step(model, data)
        force += data.sensordata[3:6]
    return np.array(log)


def rows_text(case, log, sent, seconds, rng):
    """CSV of one run."""
    c = case.columns
    head, cells = ["t_s"], []
    for k in range(6):
        head += [f"setpoint_rad_{k}"] + [
            {"applied": "applied_setpoint_rad", "position": "position_rad", "velocity": "velocity_rad_s", "current": "current_a", "duty": "duty",
             "effort": "effort_nm"}[x] + f"_{k}" for x in c if x != "bus_v"]
    head += ["bus_v"] if "bus_v" in c else []
    head += ["base_x_m", "base_y_m", "base_z_m", "base_qw", "base_qx", "base_qy", "base_qz"] if case.base else []
    head += [f"{x}_{a}" for x in ("gyro_rad_s", "accel_m_s2") for a in "xyz"] if case.imu else []
    text = [",".join(head)]
    step = 1.0 / case.rate_hz
    for n, t in enumerate(np.arange(0.0, seconds - 0.01, step)):
        at = min(int(t * 200 + 0.5), len(log) - 1)
        row = log[at]
        i = max(int(np.searchsorted(sent[0], t + 1e-9, side="right")) - 1, 0)
        cells = [f"{t:.4f}"]
        volts = 12.0
        for k in range(6):
            wire, q, w, tau = row[1 + k], row[7 + k], row[13 + k], row[19 + k]
            amps = tau / EFFORT_PER_A[k]
            value = {
                "applied": wire, "position": q + 0.0005 * rng.normal(), "velocity": w + 0.005 * rng.normal(), "effort": tau + 0.02 * rng.normal(),
                "current": amps + 0.004 * rng.normal(), "duty": (WINDING_OHM[k] * amps + EFFORT_PER_A[k] * w) / volts + 0.001 * rng.normal(),
            }
            value["duty"] = min(max(value["duty"], -1.0), 1.0)
            cells += [f"{sent[1][i][k]:.5f}"] + [f"{value[x]:.5f}" for x in c if x != "bus_v"]
        if "bus_v" in c:
            cells.append(f"{volts + 0.01 * rng.normal():.3f}")
        if case.base:
            if n % 2 == 0:
                p = row[25:28] + 0.001 * rng.normal(size=3)
                half = 0.002 * rng.normal(size=3)
                q = np.zeros(4)
                mujoco.mju_mulQuat(q, row[28:32], np.concatenate([[1.0], half]))
                q /= np.linalg.norm(q)
                cells += [f"{x:.5f}" for x in p] + [f"{x:.6f}" for x in q]
            else:
                cells += [""] * 7
        if case.imu:
            since = max(at - int(200 * step + 0.5), 0)
            accel = log[min(since + 1, at): at + 1, 35:38].mean(axis=0)
            cells += [f"{x:.5f}" for x in row[32:35] + 0.003 * rng.normal(size=3)] + [f"{x:.5f}" for x in accel + 0.02 * rng.normal(size=3)]
        text.append(",".join(cells))
    return "\n".join(text) + "\n"


def generate(case, folder, seed, model_text=None):
    """Writes the data set of `case` into `folder`, and its label beside it."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([seed, sum(map(ord, case.name))])
    model = build(case.robot)
    text = ["format = 1", 'robot = "metamodule"', f'name = "{case.name}"']
    if model_text:
        text += ["[metamodule]", 'model = "model.toml"']
        (folder / "model.toml").write_text(model_text)
    for g in range(case.gaits):
        seconds = case.lengths[g % len(case.lengths)] if case.lengths else case.seconds
        for r in range(case.repeats):
            sent = gait(case.first + g, seconds, case.vigour)
            log = play(case.robot, model, sent, seconds, rng)
            name = f"g{g:02}_{r}.csv"
            (folder / name).write_text(rows_text(case, log, sent, seconds, rng))
            text += ["", "[[run]]", f'file = "{name}"', f'gait = "g{g:02}"']
    (folder / "dataset.toml").write_text("\n".join(text) + "\n")
    Path(str(folder) + ".label.json").write_text(json.dumps({"name": case.name, "truth": list(case.truth)}))


def cases():
    """All cases, by the effects of the vocabulary."""
    out = []

    def add(name, truth=(), more=None, **robot):
        out.append(Case(name, Robot(**robot), tuple(truth), **(more or {})))

    add("w_null")
    add("w_null_effort", more={"columns": ("position", "effort")})
    add("w_null_encoders", more={"columns": ("position",)})
    add("w_null_lengths", more={"lengths": (8.0, 10.0, 12.0, 14.0)})
    add("w_null_no_repeats", more={"repeats": 1})
    add("w_null_no_base", more={"base": False})
    add("w_friction_05", ("ground_friction",), friction=0.45)
    add("w_mass", ("mass",), mass=1.25)
    add("w_slope", ("ground_slope",), slope=(0.0, 0.12))
    add("w_com", ("com_offset",), com=(0.0, 0.02, 0.0))
    add("w_torsional", ("torsional_friction",), torsional=0.02)
    add("w_coulomb_2", ("coulomb_friction@2",), coulomb={2: 0.5})
    add("w_coulomb_effort", ("coulomb_friction@4",), coulomb={4: 0.5}, more={"columns": ("position", "effort")})
    add("w_latency_1", ("latency@1",), latency={1: 0.08})
    add("w_latency_encoders", ("latency@3",), latency={3: 0.1}, more={"columns": ("position",)})
    add("w_sign_4", ("joint_sign@4",), scale={4: -1.0})
    add("w_offset_3", ("joint_offset@3",), offset={3: 0.12})
    add("w_scale_0", ("joint_scale@0",), scale={0: 1.1})
    add("w_order", ("joint_order",), order=(0, 1, 3, 2, 4, 5))
    add("w_torque_2", ("torque_limit@2",), torque={2: 1.0})
    add("w_speed_5", ("velocity_limit@5",), speed={5: 0.8})
    add("w_gain_0", ("loop_gain@0",), gain={0: 5.0})
    add("w_loss_3", ("packet_loss@3",), loss={3: 0.25})
    add("w_friction_latency", ("ground_friction", "latency@0"), friction=0.45, latency={0: 0.08})
    return out


def body_cases():
    """Causes of the body and the ground in many sizes, with and without an inertial sensor; and robots without a cause on contacts that differ."""
    out = []

    def add(name, truth=(), more=None, **robot):
        for imu in (True, False):
            more = {"imu": imu, "columns": ("applied", "position", "current", "duty", "bus_v"), "first": sum(map(ord, name)) % 40} | (more or {})
            out.append(Case(("bi_" if imu else "bo_") + name, Robot(**robot), tuple(truth), **(more | {"imu": imu})))

    contacts = {
        "a": {}, "b": {"solref": (0.02, 1.0)}, "c": {"solref": (0.004, 1.0)}, "d": {"impratio": 1.0}, "e": {"cone": "pyramidal", "impratio": 1.0},
        "f": {"impratio": 50.0}, "g": {"solref": (0.006, 0.9), "cone": "pyramidal", "impratio": 10.0},
    }
    for name, knobs in contacts.items():
        add(f"null_{name}", **knobs)
    add("null_facets", points=260)
    add("null_meek", more={"vigour": 0.6})
    add("null_lively", more={"vigour": 1.35})
    for f in (0.3, 0.5, 0.65, 1.35, 1.6):
        add(f"friction_{f}", ("ground_friction",), friction=f)
    for m in (0.7, 0.8, 1.2, 1.4):
        add(f"mass_{m}", ("mass",), mass=m)
    for roll, pitch in ((0.03, 0.0), (0.0, -0.05), (-0.08, 0.06)):
        add(f"slope_{roll}_{pitch}", ("ground_slope",), slope=(roll, pitch))
    for k, name in enumerate("xyz"):
        for size in (0.015, -0.03):
            add(f"com_{name}_{size}", ("com_offset",), middle=tuple(size if i == k else 0.0 for i in range(3)))
    for size in (0.005, 0.01, 0.02, 0.03):
        add(f"torsional_{size}", ("torsional_friction",), torsional=size)
    for ratio, direction in ((0.4, 0.0), (0.6, 0.7), (1.8, -0.5)):
        add(f"anisotropy_{ratio}_{direction}", ("friction_anisotropy",), anisotropy=(ratio, direction))
    for tau in (0.04, 0.07):
        add(f"soft_{tau}", ("ground_compliance",), solref=(tau, 1.0))
    for damping in (0.1, 0.3):
        add(f"bounce_{damping}", ("restitution",), solref=(0.01, damping))
    return out


def default_cases():
    """Robots on the contacts that MuJoCo comes with: soft, a pyramid for a cone of friction, and what sticks creeps."""
    come = {"solref": (0.02, 1.0), "impratio": 1.0, "cone": "pyramidal"}
    seen = [
        ("null_31", 31, {}), ("null_37", 37, {}), ("null_3", 3, {}), ("null_11", 11, {}), ("null_19", 19, {}),
        ("friction_0.5", 7, {"friction": 0.5}), ("friction_0.3", 13, {"friction": 0.3}), ("friction_1.5", 17, {"friction": 1.5}),
        ("mass_0.75", 9, {"mass": 0.75}), ("mass_1.3", 21, {"mass": 1.3}), ("slope_0.05_-0.06", 15, {"slope": (0.05, -0.06)}),
        ("com_y_0.03", 25, {"middle": (0.0, 0.03, 0.0)}), ("torsional_0.02", 29, {"torsional": 0.02}), ("soft_0.06", 33, {"solref": (0.06, 1.0)}),
        ("coulomb_2", 2, {"coulomb": {2: 0.5}}), ("latency_1", 4, {"latency": {1: 0.08}}), ("offset_3", 6, {"offset": {3: 0.12}}),
        ("torque_2", 8, {"torque": {2: 1.0}}), ("scale_0_friction", 10, {"scale": {0: 1.1}, "friction": 0.45}),
    ]
    blind = [("null_5", 5, {}), ("null_23", 23, {}), ("friction_0.5", 7, {"friction": 0.5})]
    columns = ("applied", "position", "current", "duty", "bus_v")
    return [
        Case(start + name, Robot(**(come | robot)), (), imu=imu, first=first, columns=columns)
        for start, imu, all_of in (("di_", True, seen), ("do_", False, blind))
        for name, first, robot in all_of
    ]


if __name__ == "__main__":
    import sys

    for case in cases() + body_cases() + default_cases():
        if case.name in sys.argv[2:] or any(x.endswith("*") and case.name.startswith(x[:-1]) for x in sys.argv[2:]):
            generate(case, Path(sys.argv[1]) / case.name, 1)
