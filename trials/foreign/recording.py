"""What robots are asked to do, what is recorded of them, and how much a cause shows in it."""

import hashlib
import json
import math
from pathlib import Path

import numpy as np

from robots import BOUNCE, FILE_KEYS, FRICTION, HALF_KG, NOMINAL, log_uniform

ROWS = 57


def gait(rng, seconds):
    """Set-points at 20 Hz: a sine a joint about an offset, amplitudes growing as the oscillators' do."""
    amplitude = np.radians(rng.uniform(12, 50, 6)) * rng.uniform(0.6, 1.2)
    offset = np.radians(rng.uniform(-25, 25, 6))
    phase = rng.uniform(-math.pi, math.pi, 6)
    hertz = rng.choice([0.15, 0.2, 0.2, 0.25, 0.3])

    def at(t):
        grown = 1.0 - np.exp(-2.0 * t)
        return offset + (grown * np.sin(2 * math.pi * hertz * t + phase[:, None])).T * amplitude

    return at


def schedules(robot, at, seconds, rng):
    """Per joint the instants at which set-points come into force, and the wire values."""
    # The first five seconds' spare holds what a skewed clock plays ahead.
    sent = np.arange(0.0, seconds + 1.0, 0.05)
    listed = at(sent)
    out = []
    for k in range(6):
        due = sent / robot.clock + robot.latency[k]
        jitter, loss, step = robot.jitter[k], robot.loss[k], robot.step_rad[k]
        # Delays of a busy wire: a skewed law with a long tail.
        extra = rng.gamma(1.5, 1.0 / math.sqrt(1.5), len(sent))
        due = np.maximum.accumulate(due + jitter * extra)
        # Losses come alone and in pairs.
        u = rng.random((2, len(sent)))
        lost = (u[0] < loss * 0.8) | (np.roll(u[0] < loss * 0.8, 1) & (u[1] < 0.2))
        lost[0] = False
        wire = listed[:, robot.order[k]]
        if step > 0:
            wire = np.round(wire / step) * step
        due[0] = -10.0
        out.append((np.ascontiguousarray(due[~lost]), np.ascontiguousarray(wire[~lost])))
    return out


def disturbance(rng, seconds):
    """Slow random torques of cables and seals: 0.05 N m, 0.2 s; steps of 10 ms."""
    n = int(seconds / 0.01) + 50
    keep = math.exp(-0.01 / 0.2)
    noise = 0.05 * math.sqrt(1 - keep * keep) * rng.normal(size=(n, 6))
    out = np.zeros((n, 6))
    for i in range(1, n):
        out[i] = keep * out[i - 1] + noise[i]
    return out


def draw_columns(rng, causes):
    """What is recorded, at what noise."""
    yes = lambda p: bool(rng.random() < p)
    c = {"position": True, "echo": yes(0.5), "effort": yes(0.7), "velocity": yes(0.6), "current": yes(0.35), "duty": yes(0.35), "bus": yes(0.45), "link": yes(0.1),
         "base": yes(0.87), "imu": yes(0.4)}
    for cause in causes:
        if cause["effect"] == "column_scale":
            column = str(rng.choice(["effort", "velocity", "current"]))
            c[column] = True
            cause["values"]["column"]["value"] = column
    noise = {"position": log_uniform(rng, 1e-4, 1e-3, False), "velocity": log_uniform(rng, 3e-3, 2e-2, False), "effort": log_uniform(rng, 0.01, 0.06, False),
             "current": log_uniform(rng, 2e-3, 8e-3, False), "duty": log_uniform(rng, 5e-4, 3e-3, False), "bus": 0.02, "link": 1e-3,
             "base": log_uniform(rng, 4e-4, 2e-3, False), "turn": log_uniform(rng, 1.5e-3, 5e-3, False), "gyro": 5e-3, "accel": 0.04}
    return c, noise


NAMES = (("echo", "applied_setpoint_rad", 1), ("position", "position_rad", 7), ("velocity", "velocity_rad_s", 13), ("effort", "effort_nm", 19),
         ("current", "current_a", 25), ("duty", "duty", 31), ("link", "link_position_rad", 51))
BUS, BASE, GYRO, ACCEL = 37, 38, 45, 48


def multiply(p, q):
    """Product of quaternions, w first."""
    a, b, c, d = p.T
    e, f, g, h = q.T
    return np.stack([a * e - b * f - c * g - d * h, a * f + b * e + c * h - d * g, a * g - b * h + c * e + d * f, a * h + b * g - c * f + d * e], 1)


def scaled(log, robot):
    """The log with columns in the units in which the robot records them."""
    for key, _, first in NAMES:
        log[:, first: first + 6] *= robot.column_scale.get(key, 1.0)
    return log


def csv(log, at, columns, noise, base_every, rng):
    """Rows of one run as they are recorded."""
    n = len(log)
    head, cells = ["t_s"], [[f"{t:.4f}" for t in log[:, 0]]]
    # A set-point holds until the next; the instants are multiples of 50 ms.
    listed = at(np.floor(log[:, 0] / 0.05 + 1e-6) * 0.05)

    def add(name, values, digits):
        head.append(name)
        cells.append([f"{v:.{digits}f}" for v in values])

    for k in range(6):
        add(f"setpoint_rad_{k}", listed[:, k], 5)
        for key, name, first in NAMES:
            x = log[:, first + k] + noise.get(key, 0.0) * rng.normal(size=n)
            x = np.clip(x, -1, 1) if key == "duty" else x
            if columns[key]:
                add(f"{name}_{k}", x, 5)
    bus = log[:, BUS] + noise["bus"] * rng.normal(size=n)
    if columns["bus"]:
        add("bus_v", bus, 3)
    if columns["imu"]:
        for first, name, sigma in ((GYRO, "gyro_rad_s", noise["gyro"]), (ACCEL, "accel_m_s2", noise["accel"])):
            for a in range(3):
                add(f"{name}_{'xyz'[a]}", log[:, first + a] + sigma * rng.normal(size=n), 4)
    if columns["base"]:
        place = log[:, BASE: BASE + 3] + noise["base"] * rng.normal(size=(n, 3))
        turn = np.concatenate([np.ones((n, 1)), 0.5 * noise["turn"] * rng.normal(size=(n, 3))], 1)
        q = multiply(log[:, BASE + 3: BASE + 7], turn)
        q /= np.linalg.norm(q, axis=1)[:, None]
        for name, values, digits in [(f"base_{'xyz'[a]}_m", place[:, a], 5) for a in range(3)] + [(f"base_q{'wxyz'[a]}", q[:, a], 6) for a in range(4)]:
            add(name, values, digits)
            cells[-1] = [c if i % base_every == 0 else "" for i, c in enumerate(cells[-1])]
    return ",".join(head) + "\n" + "\n".join(map(",".join, zip(*cells))) + "\n"


def model_text(t):
    """model.toml of a robot whose makers measured it: the nominal values, narrower tolerances."""
    out = ["format = 1", 'name = "measured meta-module"', ""]

    def one(key, value, sigma):
        out.append(f'{key} = {{ value = {value}, tolerance = {sigma}, source = "measured" }}')

    out.append("[environment]")
    one("friction", FRICTION, t["friction"])
    one("bounce", BOUNCE, t["bounce"])
    out.append("[mass]")
    for h in range(8):
        one(f"half_{h + 1}_kg", HALF_KG, t["mass"])
    for i, kind in enumerate(("intra", "inter")):
        out.append(f"[{kind}]")
        for key, name in FILE_KEYS.items():
            one(name, NOMINAL[key][i], t[key][i])
    return "\n".join(out) + "\n"


def vector(q):
    """Rotation vectors of quaternions."""
    s = np.where(q[:, :1] < 0, -1.0, 1.0)
    v = s * q[:, 1:]
    size = np.linalg.norm(v, axis=1)
    angle = 2 * np.arctan2(size, np.abs(q[:, 0]))
    return v * np.where(size > 1e-9, angle / np.maximum(size, 1e-12), 2.0)[:, None]


def differences(a, b, columns, noise, base_every):
    """Differences of two logs in the recorded columns: rows, noise of a row, and how long what repeats differ by lasts, s."""
    out = []
    for key, _, first in NAMES:
        if columns[key]:
            sigma = noise.get(key, 1e-5)
            out += [(a[:, first + k] - b[:, first + k], sigma, 0.2) for k in range(6)]
    if columns["bus"]:
        out.append((a[:, BUS] - b[:, BUS], noise["bus"], 0.2))
    if columns["base"]:
        rows = slice(None, None, base_every)
        for k in range(3):
            out.append((a[rows, BASE + k] - b[rows, BASE + k], noise["base"], 0.5))
        p, q = a[rows, BASE + 3: BASE + 7], b[rows, BASE + 3: BASE + 7].copy()
        q[:, 1:] *= -1
        turn = vector(multiply(q, p))
        out += [(turn[:, k], noise["turn"], 0.5) for k in range(3)]
    if columns["imu"]:
        out += [(a[:, GYRO + k] - b[:, GYRO + k], noise["gyro"], 0.1) for k in range(3)]
        out += [(a[:, ACCEL + k] - b[:, ACCEL + k], noise["accel"], 0.1) for k in range(3)]
    return out


def evidence(clean, alike, without, rivals, nuisances, columns, noise, base_every, rate):
    """Per cause how much chi-square it adds, what stays once the nominal numbers (each in units of its tolerance) are fitted in its place, and
    what stays beside the best of its `rivals` as well, of any size; none without a rival.
    Noise: of the columns, and what the robots `alike` differ by, which counts as one sample as long as it lasts."""
    flat = lambda logs: [d for a, b in zip(clean, logs) for d in differences(a, b, columns, noise, base_every)]
    apart = [flat(logs) for logs in alike]
    runs = len(clean)
    channels = len(apart[0]) // runs
    weights = []
    for i in range(channels):
        rows = np.concatenate([a[i + channels * r][0] for a in apart for r in range(runs)])
        _, sigma, lasts = apart[0][i]
        per = rate * len(rows) / (len(apart) * sum(map(len, clean)))
        weights.append(1.0 / math.sqrt(sigma**2 + float(np.mean(rows**2)) * max(lasts * per, 1.0)))
    stack = lambda logs: np.concatenate([d[0] * weights[i % channels] for i, d in enumerate(flat(logs))])
    jacobian = np.stack([stack(n) for n in nuisances], 1)

    def left(d, directions):
        """Chi-square of `d` once nominal numbers and free directions are fitted."""
        j = np.column_stack([jacobian, *directions])
        held = np.ones(j.shape[1])
        held[jacobian.shape[1]:] = 1e-6
        right = j.T @ d
        return max(float(d @ d - right @ np.linalg.solve(j.T @ j + np.diag(held), right)), 0.0)

    out = []
    for logs, others in zip(without, rivals):
        d = stack(logs)
        beside = [left(d, [d - stack(o)]) for o in others]
        out.append((float(d @ d), left(d, []), min(beside) if beside else None))
    return out


def write_labels(path, labels):
    """All labels as one file, and its hash beside it."""
    text = json.dumps({"format": 1, "cases": labels}, indent=1)
    Path(path).write_text(text)
    digest = hashlib.sha256(text.encode()).hexdigest()
    Path(str(path) + ".sha256").write_text(digest + "\n")
    return digest
