"""Single joints with known causes, played in MuJoCo on stands of many motors, controllers, rates and columns; labels outside the folders.

    python bench_joints.py OUT --joints 60 --seed 1 [--kind null]

writes OUT/cases/j0000/{dataset.toml, *.csv} and OUT/labels.json (with its SHA-256). The joint's laws are those of tests/foreign/bench_reality.py.
Goes on where it stopped.
"""

import argparse
import dataclasses
import json
import math
import sys
import time
from pathlib import Path

import numpy as np

import recording

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "foreign"))
import bench_reality as B  # noqa: E402

KNOWN = ("inertia", "gravity", "supply", "stall", "speed")


def between(rng, low, high):
    """Log-uniform."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def plant(rng):
    """A motor and what it carries: from a small servo to a leg's drive."""
    stall = between(rng, 0.3, 60.0)
    speed = between(rng, 2.0, 30.0)
    # It reaches its speed in 20 to 150 ms.
    inertia = stall * between(rng, 0.02, 0.15) / speed
    gravity = stall * between(rng, 0.03, 0.3) if rng.random() < 0.7 else 0.0
    return dict(inertia=inertia, gravity=gravity, stall=stall, speed=speed, supply=float(rng.choice([5.0, 7.4, 12.0, 24.0, 48.0])))


def controller(rng, p):
    """A controller that answers at 15 to 40 rad/s: P on the duty, PD and PID on the torque (also a drive's own stiffness and damping),
    a cascade, a speed servo."""
    w = rng.uniform(15.0, 40.0)
    kind = str(rng.choice(["duty", "mit", "pid", "cascade", "velocity"]))
    period = float(rng.choice([0.0005, 0.001, 0.001, 0.002, 0.005]))
    if kind == "duty":
        return kind, dict(kind="p", output="duty", kp=w * w * p["inertia"] / p["stall"], limit=1.0, period=period)
    if kind in ("mit", "pid"):
        kp = w * w * p["inertia"]
        ki = 2.0 * kp if kind == "pid" else 0.0
        return kind, dict(kind="pid", output="effort", kp=kp, ki=ki, kd=rng.uniform(0.8, 2.0) * w * p["inertia"], limit=p["stall"], period=period)
    if kind == "cascade":
        kv = 2.5 * w * p["inertia"] * p["supply"] / p["stall"]
        return kind, dict(kind="cascade", output="voltage", kp=0.4 * w, kv=kv, limit=p["supply"], period=period)
    return kind, dict(kind="p", output="velocity", kp=0.3 * w, limit=p["speed"], period=period)


def effects(p, kind):
    """Causes that this joint can have: stage, key, field of the joint, ends of the size, form. `stated`: a nominal number is stated wrong."""
    s = p["stall"]
    out = {
        "latency": ("transport", "delay_s", "latency", 0.004, 0.1, "plain"),
        "jitter": ("transport", "sigma_s", "jitter", 0.006, 0.05, "plain"),
        "packet_loss": ("transport", "probability", "loss", 0.03, 0.4, "plain"),
        "quantisation": ("transport", "step_rad", "quantum", 0.01, 0.15, "plain"),
        "joint_offset": ("conventions", "offset_rad", "offset", 0.01, 0.25, "signed"),
        "joint_scale": ("conventions", "ratio", "scale", 0.01, 0.2, "near"),
        "deadband": ("driver", "half_width_rad", "deadband", 0.003, 0.06, "plain"),
        "loop_gain": ("driver", "ratio", "kp", 0.05, 0.6, "stated"),
        "velocity_limit": ("driver", "limit_rad_s", "slew", 0.5, 2.0, "plain"),
    }
    if kind == "velocity":
        return out
    out |= {
        "feedback_delay": ("driver", "delay_s", "feedback_delay", 0.003, 0.015, "plain"),
        "motor_lag": ("driver", "time_constant_s", "lag", 0.003, 0.03, "plain"),
        "torque_limit": ("electrical", "limit_nm", "torque_limit", 0.15 * s, 0.6 * s, "plain"),
        "coulomb_friction": ("drivetrain", "torque_nm", "coulomb", 0.008 * s, 0.15 * s, "plain"),
        "viscous_friction": ("drivetrain", "nm_s_rad", "viscous", 0.006 * s, 0.1 * s, "plain"),
        "stribeck_friction": ("drivetrain", "static_nm", "static", 0.02 * s, 0.15 * s, "plain"),
        "quadratic_friction": ("drivetrain", "nm_s2_rad2", "quadratic", 0.006 * s, 0.08 * s, "plain"),
        "asymmetric_friction": ("drivetrain", "difference_nm", "asymmetry", 0.02 * s, 0.12 * s, "plain"),
        "torque_ripple": ("drivetrain", "amplitude_nm", "ripple", 0.01 * s, 0.08 * s, "plain"),
        "inertia": ("drivetrain", "ratio", "inertia", 0.05, 0.6, "stated"),
        "backlash": ("transmission", "half_width_rad", "play", 0.004, 0.06, "plain"),
        "compliance": ("transmission", "stiffness_nm_rad", "stiffness", 4 * s, 80 * s, "plain"),
    }
    if p["gravity"] > 0:
        out["load_dependent_friction"] = ("drivetrain", "fraction", "load_share", 0.04, 0.4, "plain")
        out["gravity_load"] = ("drivetrain", "ratio", "gravity", 0.05, 0.7, "stated")
        out["payload"] = ("drivetrain", "ratio", "payload", 0.1, 1.5, "payload")
    if kind in ("duty", "cascade"):
        ohm = p["supply"] ** 2 / (p["speed"] * s)
        out["supply_voltage"] = ("supply", "value_v", "supply", 0.03, 0.4, "stated")
        out["supply_sag"] = ("supply", "resistance_ohm", "sag", 0.05 * ohm, 0.6 * ohm, "plain")
    return out


OUTSIDE = {
    "position_friction": ("drivetrain", "torque_nm", "position_friction", 0.06, 0.25, "plain"),
    "hardening_spring": ("drivetrain", "nm_rad3", "hardening", 0.05, 0.4, "plain"),
}
ROBOT_SCOPE = ("supply_voltage", "supply_sag")


def plant_cause(rng, name, entry, joint, nominal, s):
    """Draws a cause into `joint`, or a wrong statement into `nominal`; returns its label and what takes it away again."""
    stage, key, place, low, high, form = entry
    x = between(rng, low, high)
    sign = float(rng.choice([-1.0, 1.0]))
    if form == "payload":
        # One mass more at the end: gravity, and inertia as far as it is that of a point mass there.
        before = {"gravity": joint.gravity, "inertia": joint.inertia}
        nominal |= before
        joint.gravity *= 1 + x
        joint.inertia += before["inertia"] * x * 0.8
        value = 1 + x
    elif form == "stated":
        value = math.exp(sign * x)
        nominal[place] = getattr(joint, place) / value
        before = {place: nominal[place]}
        if name == "supply_voltage":
            value = joint.supply
    else:
        value = {"plain": x, "signed": sign * x, "near": 1 + sign * x}[form]
        before = {place: 1.0 if form == "near" else 0.0}
        setattr(joint, place, value * (s if name in OUTSIDE else 1.0))
    once = name in ROBOT_SCOPE
    values = {key: {"value": value} if once else {"value": value, "by_joint": {"0": value}}}
    if name == "stribeck_friction":
        joint.stribeck_speed = between(rng, 0.05, 0.2)
        values["velocity_rad_s"] = {"value": joint.stribeck_speed, "by_joint": {"0": joint.stribeck_speed}}
    also = {"payload": ["gravity_load"], "viscous_friction": ["damping_gain"], "hardening_spring": []}.get(name, [])
    cause = {"effect": name, "stage": stage, "scope": "robot" if once else "joint", "joints": [] if once else [0], "values": values, "also": also}
    return cause, before


COLUMNS = (
    ("position", "velocity", "current", "duty", "bus_v"), ("position", "velocity", "current", "duty", "bus_v"), ("position", "current"),
    ("position", "velocity", "effort"), ("position", "effort"), ("position", "current_abs"), ("position", "velocity"), ("position",),
)


def noise_of(column, joint, record):
    """1 sigma of a column of bench_reality."""
    return {"position": record.encoder / math.sqrt(12), "link": record.encoder / math.sqrt(12), "velocity": 0.001 * joint.speed,
            "current": record.current_noise, "duty": 1e-3, "bus_v": 0.005, "effort": 1e-3 * joint.stall}[column.removesuffix("_abs")]


def motions(case, joint, rng_seed, shaken=0):
    """Two gaits of a joint at 1 kHz, the same traffic and disturbance for the same seed."""
    out = []
    for g, gait in enumerate(case.gaits[:2]):
        j = dataclasses.replace(joint)
        j.supply_of_constant = case.joint.supply_of_constant
        sent = B.stimulus(gait, case.seconds, case.setpoint_hz, case.size)
        out.append(B.run(j, sent, case.seconds, case.step, np.random.default_rng([rng_seed, g, shaken]), case.disturbance))
    return out


def shown(case, causes, seed):
    """Chi-square of every cause in the recorded columns, and what stays of it once stated numbers are fitted within their tolerances."""
    rows = slice(None, None, max(1, int(round(1000 / case.record.rate_hz))))
    clean = motions(case, case.joint, seed)
    again = motions(case, case.joint, seed, 1)
    columns = [c for c in case.record.columns] + (["applied"] if case.record.echo else [])
    weights = {}
    for c in columns:
        index = B.COLUMN[c.removesuffix("_abs")]
        sigma = 1e-5 if c == "applied" else noise_of(c, case.joint, case.record)
        spread = np.mean([np.mean((a[rows, index] - b[rows, index]) ** 2) for a, b in zip(clean, again)])
        spread = 0.0 if c == "applied" else spread
        weights[c] = 1 / math.sqrt(sigma**2 + spread * max(0.3 * case.record.rate_hz, 1.0))

    def stack(other):
        size = min(len(a) for a in clean)
        return np.concatenate([(np.abs(a[:size][rows, i]) - np.abs(b[:size][rows, i]) if c.endswith("_abs") else a[:size][rows, i] - b[:size][rows, i]) * w
                               for a, b in zip(clean, other) for c, w in weights.items() for i in [B.COLUMN[c.removesuffix("_abs")]]])

    nuisances = []
    for key in KNOWN:
        if getattr(case.joint, key):
            nuisances.append(stack(motions(case, dataclasses.replace(case.joint, **{key: getattr(case.joint, key) * (1 + case.tolerance)}), seed)))
    jacobian = np.stack(nuisances, 1)
    normal = jacobian.T @ jacobian + np.eye(jacobian.shape[1])
    scale = len(case.gaits) * case.repeats / 2
    for cause, before in causes:
        d = stack(motions(case, dataclasses.replace(case.joint, **before), seed))
        full = float(d @ d)
        left = full - float((jacobian.T @ d) @ np.linalg.solve(normal, jacobian.T @ d))
        cause["delta_chi2"], cause["delta_chi2_refitted"] = round(scale * full, 2), round(scale * left, 2)


def sigmas(cause, joint, nominal, tolerance):
    """By how many tolerances a stated number is off."""
    place = {"inertia": "inertia", "gravity_load": "gravity", "supply_voltage": "supply"}.get(cause["effect"])
    if place:
        cause["sigmas"] = abs(getattr(joint, place) / nominal[place] - 1) / tolerance


def draw(seed, number, kind):
    """A case of bench_reality, and its label."""
    rng = np.random.default_rng([seed, number, 77])
    x = rng.random()
    kind = kind or ("null" if x < 0.25 else "single" if x < 0.67 else "several" if x < 0.94 else "outside")
    p = plant(rng)
    drive, c = controller(rng, p)
    joint, nominal, tolerance = B.Joint(**(p | c)), {}, float(rng.choice([0.02, 0.05]))
    # What is stated is off by its tolerance, Gaussian and not cut off.
    for key in KNOWN:
        nominal[key] = getattr(joint, key) * (1 + tolerance * float(rng.normal()))
    table = OUTSIDE if kind == "outside" else effects(p, drive)
    count = {"null": 0, "several": 2 + int(rng.random() < 0.3)}.get(kind, 1)
    clash = {"payload": {"gravity_load", "inertia"}, "gravity_load": {"payload"}, "inertia": {"payload"}, "backlash": {"compliance"}, "compliance": {"backlash"}}
    causes, taken = [], set()
    for _ in range(count):
        name = str(rng.choice(sorted(set(table) - taken)))
        taken |= {name} | clash.get(name, set())
        causes.append(plant_cause(rng, name, table[name], joint, nominal, p["stall"]))
    columns = COLUMNS[rng.integers(len(COLUMNS))]
    if drive in ("mit", "pid", "velocity"):
        columns = tuple(x for x in columns if x not in ("duty", "bus_v"))
    rate = float(rng.choice([50.0, 100.0, 200.0, 500.0]))
    record = B.Record(columns=columns, rate_hz=rate, encoder=2 * math.pi / float(rng.choice([1024, 4096, 16384])), echo=bool(rng.random() < 0.3),
                      current_noise=0.002 * p["stall"] * p["speed"] / p["supply"])
    joint.supply_of_constant = nominal["supply"] if any(c["effect"] == "supply_voltage" for c, _ in causes) else joint.supply
    case = B.Case(f"j{number:04}", joint, record, (), nominal, tolerance=tolerance)
    case.gaits, case.repeats, case.seconds = tuple(str(g) for g in rng.permutation(B.GAITS)[: int(rng.integers(4, 7))]), 2, 8.0
    case.size = 0.7 if c["output"] == "effort" else 1.0
    case.disturbance = 0.004 * p["stall"]
    case.setpoint_hz = min(rate, float(rng.choice([20.0, 50.0, 100.0])))
    for cause, _ in causes:
        sigmas(cause, joint, nominal, tolerance)
    label = {"name": case.name, "engine": "mujoco joint", "kind": kind, "columns": list(columns), "drive": drive, "plant": p, "rate_hz": rate, "tolerance": tolerance}
    return case, label, causes


def main():
    a = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument("out")
    a.add_argument("--joints", type=int, default=60)
    a.add_argument("--seed", type=int, default=1)
    a.add_argument("--kind", choices=["null", "single", "several", "outside"])
    args = a.parse_args()
    out = Path(args.out)
    (out / "parts").mkdir(parents=True, exist_ok=True)
    labels = []
    for number in range(args.joints):
        part = out / "parts" / f"j{number:04}.json"
        if not part.exists():
            start = time.perf_counter()
            case, label, causes = draw(args.seed, number, args.kind)
            B.generate(case, out / "cases" / case.name, args.seed)
            (out / "cases" / f"{case.name}.label.json").unlink()
            if causes:
                shown(case, causes, args.seed * 100000 + number)
            label["causes"] = [c for c, _ in causes]
            part.write_text(json.dumps(label))
            said = " + ".join(f"{c['effect']} {c['delta_chi2']:.0f}>{c['delta_chi2_refitted']:.0f}" for c in label["causes"])
            print(f"{label['name']} {time.perf_counter() - start:.1f} s {label['kind']} {label['drive']} {said}", flush=True)
        labels.append(json.loads(part.read_text()))
    print("labels", recording.write_labels(out / "labels.json", labels))


if __name__ == "__main__":
    main()
