"""One joint on a stand, played by MuJoCo and motor laws of its own: data set folders with known causes.

Shares no code with the diagnosis or with the emulated robot: rigid bodies, joint limits (play) and springs are MuJoCo's, friction is a
LuGre bristle or MuJoCo's friction loss, the motor and its controller are written out below.
"""

import json
import math
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

GRAVITY_M_S2 = 9.81


@dataclass
class Joint:
    """What the joint really is. Nominal values are these with tolerances drawn on top, unless an effect changes them."""

    command: str = "position"
    motion: str = "rotary"
    inertia: float = 0.005
    gravity: float = 0.4
    supply: float = 7.4
    stall: float = 1.6
    speed: float = 8.0
    kind: str = "p"
    output: str = "duty"
    kp: float = 3.0
    ki: float = 0.0
    kd: float = 0.0
    kv: float = 0.0
    limit: float = 1.0
    period: float = 0.001
    # effects, neutral
    coulomb: float = 0.0
    coulomb_law: str = "lugre"
    static: float = 0.0
    stribeck_speed: float = 0.1
    viscous: float = 0.0
    load_share: float = 0.0
    asymmetry: float = 0.0
    quadratic: float = 0.0
    ripple: float = 0.0
    ripple_periods: float = 6.0
    play: float = 0.0
    stiffness: float = 0.0
    latency: float = 0.0
    feedback_delay: float = 0.0
    deadband: float = 0.0
    lag: float = 0.0
    slew: float = 0.0
    torque_limit: float = 0.0
    current_limit: float = 0.0
    derate_share: float = 0.0
    derate_time: float = 10.0
    sag: float = 0.0
    offset: float = 0.0
    scale: float = 1.0
    quantum: float = 0.0
    skew: float = 0.0
    loss: float = 0.0
    jitter: float = 0.0
    # outside the vocabulary
    hardening: float = 0.0
    position_friction: float = 0.0


@dataclass
class Record:
    """How the lab records."""

    rate_hz: float = 100.0
    row_jitter: float = 0.0
    columns: tuple = ("position", "velocity", "current", "duty", "bus_v")
    encoder: float = 2 * math.pi / 4096
    current_noise: float = 0.004
    own_rows: bool = False
    bus_hz: float = 0.0
    echo: bool = False
    drop_rows: float = 0.0


def stimulus(name, seconds, rate_hz, size):
    """Set-points as (time, value)."""
    t = np.arange(0.0, seconds, 1.0 / rate_hz)
    tau = 2 * math.pi
    ramp = np.minimum(1.0, t / 0.5)
    if name == "slow":
        q = 1.0 * np.sin(tau * 0.3 * t)
    elif name == "fast":
        q = 0.6 * np.sin(tau * 1.1 * t)
    elif name == "steps":
        q = np.array([0.0, 0.7, -0.3, 0.4, -0.8, 0.1, -0.1, 0.0])[(t / (seconds / 8.0)).astype(int) % 8]
        ramp = 1.0
    elif name == "triangle":
        q = 0.9 * (2 / math.pi) * np.arcsin(np.sin(tau * 0.2 * t))
    elif name == "chirp":
        q = 0.5 * np.sin(tau * (0.2 * t + 0.5 * (2.0 - 0.2) / seconds * t * t))
    elif name == "mixed":
        q = 0.4 * np.sin(tau * 0.37 * t) + 0.3 * np.sin(tau * 0.83 * t + 1.0) + 0.15 * np.sin(tau * 1.9 * t)
    else:
        raise ValueError(name)
    return t, size * ramp * q


GAITS = ("slow", "steps", "mixed", "fast", "triangle", "chirp")


def model_xml(j, h):
    """The joint as MuJoCo's bodies: the rotor, and the load behind play or a spring where there is one."""
    two = j.play > 0.0 or j.stiffness > 0.0
    axis, kind = ("1 0 0", "slide") if j.motion == "linear" else ("0 1 0", "hinge")
    share = 0.6
    load = (1.0 - share) * j.inertia if two else j.inertia
    if j.gravity > 0.0:
        arm = 0.5 * load * GRAVITY_M_S2 / j.gravity
        mass = j.gravity / (GRAVITY_M_S2 * arm)
        rest = load - mass * arm * arm
    else:
        arm, mass, rest = 0.0, load if kind == "slide" else 1e-6, 0.0 if kind == "slide" else load
    loss = j.coulomb if j.coulomb_law == "mujoco" else 0.0
    tight = 'solreffriction="0.004 1" solimpfriction="0.999 0.9999 0.001"'
    inertial = f'<inertial pos="0 0 {-arm}" mass="{mass}" diaginertia="1e-9 1e-9 1e-9"/>'
    first = f'<joint name="m" type="{kind}" axis="{axis}" damping="{j.viscous}" frictionloss="{loss}" {tight}'
    if not two:
        body = f'{first} armature="{max(rest, 0.0)}"/>{inertial}'
    else:
        if j.play > 0.0:
            link = f'limited="true" range="{-j.play} {j.play}" solreflimit="0.002 1" solimplimit="0.99 0.9999 0.0002" damping="{0.02 * math.sqrt(load * j.stall)}"'
        else:
            link = f'stiffness="{j.stiffness}" damping="{0.1 * math.sqrt(load * j.stiffness)}"'
        # The load turns with its body: an armature would count its speed against the rotor's.
        own = max(rest, 1e-9)
        inertial = f'<inertial pos="0 0 {-arm}" mass="{mass}" diaginertia="{own} {own} {own}"/>'
        body = (
            f'{first} armature="{share * j.inertia}"/><inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>'
            f'<body><joint name="l" type="{kind}" axis="{axis}" {link}/>{inertial}</body>'
        )
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{h}" integrator="implicitfast" gravity="0 0 {-GRAVITY_M_S2}"/>'
        f"<worldbody><body>{body}</body></worldbody></mujoco>"
    )


class Motor:
    """Controller, electronics and friction; all state between calls."""

    def __init__(self, j, h, q, w):
        self.j, self.h = j, h
        self.integral = self.u = self.lagged = self.z = self.heat = 0.0
        self.bus, self.i, self.duty, self.effort = j.supply, 0.0, 0.0, 0.0
        self.next_s = 0.0
        self.applied = None
        self.past = deque(maxlen=max(1, int(round(j.feedback_delay / h)) + 1))
        self.last_q = q

    def control(self, t, sp, q, w):
        j = self.j
        self.past.append((q, w))
        if t + 1e-9 < self.next_s:
            return
        self.next_s += j.period
        q, w = self.past[0]
        if j.slew > 0.0:
            self.applied = q if self.applied is None else self.applied
            step = j.slew * j.period
            self.applied += min(max(sp - self.applied, -step), step)
            sp = self.applied
        e = sp - q
        e = 0.0 if abs(e) < j.deadband else e - math.copysign(j.deadband, e)
        if j.kind == "cascade":
            u = j.kv * (j.kp * e - w)
        elif j.kind == "pid":
            trial = self.integral + e * j.period
            u = j.kp * e + j.ki * trial - j.kd * w
            if abs(u) < j.limit:
                self.integral = trial
        else:
            u = j.kp * e
        self.u = min(max(u, -j.limit), j.limit)

    def torque(self, command, w):
        """Effort at the output from the controller's output (or the command itself)."""
        j = self.j
        u = command
        if j.lag > 0.0:
            self.lagged += (u - self.lagged) * (1.0 - math.exp(-self.h / j.lag))
            u = self.lagged
        kt = j.supply_of_constant / j.speed if j.speed > 0.0 else 1.0
        resistance = kt * j.supply_of_constant / j.stall
        if j.output == "effort":
            tau = u
            self.i = tau / kt
        elif j.output == "velocity":
            tau = 0.2 * j.inertia / self.h * (u - w)
            tau = min(max(tau, -j.stall), j.stall)
            self.i = tau / kt
        else:
            volts = u * self.bus if j.output == "duty" else min(max(u, -self.bus), self.bus)
            self.duty = volts / self.bus
            emf = kt * w if j.speed > 0.0 else 0.0
            self.i = (volts - emf) / resistance
            if j.current_limit > 0.0:
                self.i = min(max(self.i, -j.current_limit), j.current_limit)
            tau = kt * self.i
            self.bus = j.supply - j.sag * max(0.0, self.i * self.duty)
        if j.output in ("effort", "velocity"):
            self.duty = min(max((resistance * self.i + kt * w) / self.bus, -1.0), 1.0)
        if j.derate_share > 0.0:
            self.heat += self.h / j.derate_time * (1.0 - self.heat)
            tau *= 1.0 - j.derate_share * self.heat
        if j.torque_limit > 0.0:
            tau = min(max(tau, -j.torque_limit), j.torque_limit)
        self.effort = tau
        return tau

    def friction(self, q, w, tau, load):
        """Bristle friction (LuGre, integrated exactly for constant speed)."""
        j = self.j
        dry = j.coulomb if j.coulomb_law == "lugre" else 0.0
        level = dry + j.static * math.exp(-((w / j.stribeck_speed) ** 2)) + j.load_share * abs(load)
        level += 0.5 * j.asymmetry * math.tanh(w / 0.01)
        level += j.position_friction * (1.0 + math.sin(5.0 * q)) * 0.5
        drag = j.quadratic * w * abs(w)
        if level <= 1e-9:
            return -drag
        stiff = level / 3e-4
        steady = math.copysign(level / stiff, w)
        rate = stiff * abs(w) / level
        old = self.z
        self.z = steady + (old - steady) * math.exp(-rate * self.h)
        dz = (self.z - old) / self.h
        return -(stiff * self.z + 0.2 * math.sqrt(stiff * j.inertia) * dz) - drag


def arrivals(t, v, j, rng):
    """When set-points reach the driver."""
    keep = rng.random(len(t)) >= j.loss
    keep[0] = True
    at = t * (1.0 + j.skew) + j.latency + (np.abs(rng.normal(0.0, j.jitter, len(t))) if j.jitter > 0 else 0.0)
    at = np.maximum.accumulate(at)
    w = j.scale * v + j.offset
    if j.quantum > 0.0:
        w = np.round(w / j.quantum) * j.quantum
    return at[keep], w[keep]


def run(j, setpoints, seconds, h, rng, disturbance, enable=None, log_hz=1000.0):
    """Simulates one run; a dictionary of columns at log_hz on the robot's clock."""
    j.supply_of_constant = getattr(j, "supply_of_constant", j.supply)
    model = mujoco.MjModel.from_xml_string(model_xml(j, h))
    data = mujoco.MjData(model)
    at, value = arrivals(*setpoints, j, rng)
    motor = Motor(j, h, 0.0, 0.0)
    phase, period = rng.random(2) * 6.28, 0.7 + rng.random(2) * 2.0
    bend = 0.3 * j.gravity * 3.0
    every = max(1, int(round(1.0 / (log_hz * h))))
    log, k, two = [], 0, model.nv == 2
    sp = value[0] if j.command == "position" else 0.0
    ripple, extra = j.ripple, j.hardening
    for n in range(int(seconds / h)):
        t = n * h
        while k < len(at) and at[k] <= t + 1e-9:
            sp = value[k]
            k += 1
        q, w = float(data.qpos[0]), float(data.qvel[0])
        on = enable is None or enable(t)
        if j.command == "position":
            motor.control(t, sp, q, w)
            command = motor.u
        else:
            command = sp
        tau = motor.torque(command, w) if on else 0.0
        if not on:
            motor.i = motor.duty = motor.effort = 0.0
        if n % every == 0:
            log.append((t, q, q + float(data.qpos[1]) if two else q, w, motor.i, motor.duty, motor.bus, motor.effort, sp, float(on)))
        load = tau - j.gravity * math.sin(q)
        load = max(abs(tau), abs(j.gravity * math.sin(q)))
        force = tau + motor.friction(q, w, tau, load) + ripple * math.sin(j.ripple_periods * q + 0.4)
        force -= extra * q * q * q
        force += disturbance * math.sin(period[0] * t + phase[0]) * math.sin(period[1] * t + phase[1])
        data.qfrc_applied[0] = force
        mujoco.mj_step(model, data)
    return np.array(log)


def names(motion):
    """Header names by motion."""
    a, v, e = ("rad", "rad_s", "nm") if motion == "rotary" else ("m", "m_s", "n")
    return {
        "setpoint": f"setpoint_{a}", "applied": f"applied_setpoint_{a}", "position": f"position_{a}",
        "link": f"link_position_{a}", "velocity": f"velocity_{v}", "current": "current_a", "current_abs": "current_abs_a",
        "duty": "duty", "bus_v": "bus_v", "effort": f"effort_{e}", "effort_abs": f"effort_{e}_abs", "enable": "enable",
    }


COLUMN = {"position": 1, "link": 2, "velocity": 3, "current": 4, "duty": 5, "bus_v": 6, "effort": 7, "applied": 8, "enable": 9}


def rows_of(log, sent, record, j, seconds, rng, enabled):
    """The recording as sorted (time, {column: value})."""
    step = 1.0 / record.rate_hz
    at = np.arange(0.0, seconds - 0.01, step)
    if record.row_jitter > 0.0:
        at = np.maximum.accumulate(at + np.abs(rng.normal(0.0, record.row_jitter * step, len(at))))
    if record.drop_rows > 0.0:
        at = at[rng.random(len(at)) >= record.drop_rows]
    index = np.minimum((at * 1000.0 + 0.5).astype(int), len(log) - 1)
    out = []
    for t, i in zip(log[index, 0], index):
        row = {}
        for c in record.columns:
            x = log[i, COLUMN[c.removesuffix("_abs")]]
            if c in ("position", "link") and record.encoder > 0.0:
                x = round(x / record.encoder) * record.encoder
            if c.startswith("current"):
                x += rng.normal(0.0, record.current_noise)
            if c == "velocity":
                x += rng.normal(0.0, 0.01 * j.speed * 0.1)
            if c == "bus_v":
                if record.bus_hz > 0.0:
                    continue
                x += rng.normal(0.0, 0.005)
            row[c] = abs(x) if c.endswith("_abs") else x
        if record.echo:
            row["applied"] = log[i, COLUMN["applied"]]
        if enabled:
            row["enable"] = log[i, COLUMN["enable"]]
        out.append((t, row))
    if record.bus_hz > 0.0 and "bus_v" in record.columns:
        for t in np.arange(0.0131, seconds - 0.01, 1.0 / record.bus_hz):
            out.append((t, {"bus_v": log[int(t * 1000), 6] + rng.normal(0.0, 0.005)}))
    if record.own_rows:
        out += [(t, {"setpoint": v}) for t, v in zip(*sent) if t < seconds - 0.01]
    else:
        times, values = sent
        for t, row in out:
            if record.bus_hz <= 0.0 or "position" in row or len(row) > 1:
                row["setpoint"] = values[max(0, int(np.searchsorted(times, t + 1e-9, side="right")) - 1)]
    return sorted(out, key=lambda r: r[0])


def write_csv(path, rows, order, motion, rename, drop=(), alias=None):
    """Writes the rows; `rename` maps canonical header names to those of the file."""
    head = names(motion)
    if alias:
        head = {**head, "setpoint": alias}
    order = [c for c in order if c not in drop]
    text = ["t_s," + ",".join(rename.get(head[c], head[c]) for c in order)]
    for t, row in rows:
        cells = [("" if c not in row else f"{row[c]:.6g}" if c != "enable" else f"{row[c]:.0f}") for c in order]
        if any(cells):
            text.append(f"{t:.5f}," + ",".join(cells))
    path.write_text("\n".join(text) + "\n")


@dataclass
class Case:
    """One data set folder and its label."""

    name: str
    joint: Joint = field(default_factory=Joint)
    record: Record = field(default_factory=Record)
    truth: tuple = ()
    nominal: dict = field(default_factory=dict)
    known: tuple = ("inertia", "gravity", "supply", "stall", "speed", "controller")
    tolerance: float = 0.03
    write_tolerance: bool = True
    gaits: tuple = GAITS
    repeats: int = 2
    seconds: float = 8.0
    setpoint_hz: float = 50.0
    size: float = 1.0
    disturbance: float = 0.002
    enable: object = None
    rename: dict = field(default_factory=dict)
    check_blind: bool = False
    roles: object = None
    overrides: object = None
    alias: str = ""
    step: float = 0.0005


def key_values(case, rng):
    """The [bench] table: true values off by their tolerance, or the nominal ones an effect departs from."""
    j, lines = case.joint, []
    linear = j.motion == "linear"
    keys = {
        "inertia": ("mass_kg" if linear else "inertia_kg_m2", j.inertia),
        "gravity": ("gravity_n" if linear else "gravity_nm", j.gravity),
        "supply": ("supply_v", j.supply),
        "stall": ("max_effort_n" if linear else "max_effort_nm", j.stall),
        "speed": ("max_speed_m_s" if linear else "max_speed_rad_s", j.speed),
    }
    lines += [f'command = "{j.command}"', f'motion = "{j.motion}"']
    for k, (key, value) in keys.items():
        if k not in case.known:
            continue
        value = case.nominal.get(k, value * (1.0 + case.tolerance * float(np.clip(rng.normal(), -2, 2))))
        both = f"{{ value = {value:.6g}, tolerance = {case.tolerance} }}"
        lines.append(f"{key} = {both if case.write_tolerance else f'{value:.6g}'}")
    if "controller" in case.known and j.command == "position":
        lines += ["[bench.controller]", f'kind = "{j.kind}"', f'output = "{j.output}"']
        for k in ("kp", "ki", "kd", "kv"):
            value = case.nominal.get(k, getattr(j, k))
            if value:
                lines.append(f"{k} = {value:.6g}")
        lines += [f"limit = {case.nominal.get('limit', j.limit):.6g}", f"period_s = {j.period:.6g}"]
    elif j.command == "position" and "output" in case.known:
        lines += ["[bench.controller]", f'output = "{j.output}"']
    return lines


def generate(case, folder, seed):
    """Writes the data set of `case` into `folder`, and its label beside it."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([seed, sum(map(ord, case.name))])
    text = ["format = 1", 'robot = "bench"', f'name = "{case.name}"']
    if case.rename:
        text += ["[signals]"] + [f'"{k}" = "{v}"' for k, v in case.rename.items()]
    text += ["[bench]"] + key_values(case, rng)
    if not hasattr(case.joint, "supply_of_constant"):
        case.joint.supply_of_constant = case.nominal.get("supply", case.joint.supply)
    for g, gait in enumerate(case.gaits):
        for r in range(case.repeats):
            j = Joint(**{k: getattr(case.joint, k) for k in Joint.__dataclass_fields__})
            j.supply_of_constant = case.joint.supply_of_constant
            extra = case.overrides(g, r, j) if case.overrides else []
            sent = stimulus(gait, case.seconds, case.setpoint_hz, case.size)
            log = run(j, sent, case.seconds, case.step, rng, case.disturbance, case.enable)
            rows = rows_of(log, sent, case.record, j, case.seconds, rng, case.enable is not None)
            order = ["setpoint", *(["applied"] if case.record.echo else []), *(["enable"] if case.enable else []), *case.record.columns]
            role = case.roles(g, r) if case.roles else None
            blind = case.check_blind and role == "check"
            file = f"{gait}_{r}.csv"
            write_csv(folder / file, rows, order, j.motion, case.rename, case.record.columns if blind else (), case.alias)
            text += ["", "[[run]]", f'file = "{file}"', f'gait = "{gait}"'] + ([f'role = "{role}"'] if role else []) + extra
    (folder / "dataset.toml").write_text("\n".join(text) + "\n")
    label = {"name": case.name, "truth": list(case.truth)}
    Path(str(folder) + ".label.json").write_text(json.dumps(label))
