"""A suite of robots with labels, whatever engine plays them."""

import argparse
import ctypes
import json
import math
import subprocess
import time
from pathlib import Path

import numpy as np

import recording
import robots as R

SETTLE_S = 2.0


def compiled(folder, name, before, after):
    """NAME.c and the law of joints as a library."""
    out = Path(folder) / f"{name}.so"
    sources = [R.HERE / "law.c", R.HERE / f"{name}.c"]
    if not out.exists() or any(s.stat().st_mtime > out.stat().st_mtime for s in [*sources, R.HERE / "law.h"]):
        subprocess.run(["gcc", "-O2", "-shared", "-fPIC", *before, *sources, *after, "-lm", "-o", out], check=True)
    return ctypes.CDLL(str(out))


def run(engine, robot, contact, at, seconds, rate, rng, others=()):
    """Plays one run; `others` are robots that begin again where it is. Returns its log and theirs."""
    homing, start, tension = 1e-3 * rng.normal(size=6), 3e-3 * rng.normal(size=6), 0.04 * rng.normal()
    rub, yaw, seed = 1 + 0.02 * rng.normal(), 0.05 * rng.normal(), int(rng.integers(2**31))
    push = recording.disturbance(rng, SETTLE_S + seconds)
    first, runs = at(np.zeros(1))[0], []
    for r in (robot, *others):
        r = r.copy()
        r.joints[:, R.JOINT["HOMING"]] = homing
        r.robot[R.ROBOT["VOLTS"]] += tension
        r.friction *= rub
        # The same traffic for all: what a cause changes of it is the cause's.
        traffic = recording.schedules(r, at, seconds, np.random.default_rng(seed))
        j = r.joints.T
        goal = j[R.JOINT["SIGN"]] * j[R.JOINT["SCALE"]] * first[list(r.order)] + j[R.JOINT["OFFSET"]]
        runs.append((r, getattr(r, "contact", contact), traffic, goal + start, yaw))
    shaken = recording.disturbance(np.random.default_rng(seed + 1), SETTLE_S + seconds)
    played = engine.play(runs, seconds, rate, push, [shaken if getattr(o, "shaken", False) else push for o in others])
    if played is None or not np.isfinite(played[0]).all():
        return None, None
    log, logs = played
    return recording.scaled(log, robot), [recording.scaled(x, r) for x, r in zip(logs, others)]


def repeats(engine, robot, contact):
    """The same robot once more, and on the contacts of two other simulators: what no diagnosis can tell from noise."""
    again, stiff, soft = robot.copy(), robot.copy(), robot.copy()
    again.shaken = True
    stiff.contact, soft.contact = engine.other_contacts(contact)
    for r, factor in ((stiff, 1.5), (soft, 0.7)):
        if robot.contact_rad_s > 100:
            r.contact_rad_s *= factor
    return [again, stiff, soft]


def off_nominal(robot, tolerances):
    """Robots in which one nominal number more is off by a tolerance: what a diagnosis may fit in a cause's place."""
    out = []

    def one(change):
        r = robot.copy()
        change(r)
        out.append(r)

    for key in ("GAIN", "SPEED_LIMIT", "TORQUE_LIMIT", "DAMPING"):
        for kind in (0, 1):
            joints = list(R.KINDS["inter" if kind else "intra"])

            def shift(r, key=key, kind=kind, joints=joints):
                r.joints[joints, R.JOINT[key]] += tolerances[key][kind]

            one(shift)
    for key in ("TORQUE_PER_AMP", "OHM"):
        one(lambda r, key=key: r.joints.__setitem__((slice(None), R.JOINT[key]), r.joints[:, R.JOINT[key]] * (1 + R.MOTOR[key])))
    one(lambda r: r.robot.__setitem__(R.ROBOT["VOLTS"], r.robot[R.ROBOT["VOLTS"]] * (1 + R.MOTOR["VOLTS"])))
    one(lambda r: setattr(r, "friction", r.friction * (1 - min(tolerances["friction"], 0.5))))
    one(lambda r: setattr(r, "halves_kg", r.halves_kg + tolerances["mass"]))
    one(lambda r: setattr(r, "halves_kg", r.halves_kg + tolerances["mass"] * np.linspace(-1.5, 1.5, 8)))
    one(lambda r: setattr(r, "bounce", min(r.bounce + tolerances["bounce"], 0.95)))
    return out


def draw(engine, seed, number, kind):
    """All that a robot is drawn from: itself, its causes, contacts, columns, gaits."""
    rng = np.random.default_rng([seed, number])
    x = rng.random()
    kind = kind or ("null" if x < 0.25 else "single" if x < 0.67 else "several" if x < 0.94 else "outside")
    measured = bool(rng.random() < 0.5)
    tolerances = R.MEASURED if measured else R.SHIPPED
    style = {"rotor": rng.uniform(0.01, 0.05), "bristle": rng.uniform(1e-3, 5e-3), "power": float(rng.choice([1.0, 2.0])), "contact_rad_s": R.log_uniform(rng, 120, 400, False)}
    contact = engine.contact(rng)
    robot = R.nominal(tolerances, rng, style)
    causes = R.draw_causes(rng, kind)
    columns, noise = recording.draw_columns(rng, causes)
    rate = int(rng.choice([50, 100]))
    return {"kind": kind, "measured": measured, "tolerances": tolerances, "robot": robot, "causes": causes, "columns": columns, "noise": noise, "style": style,
            "contact": contact, "rate": rate, "base_every": int(rng.choice([1, 2, rate // 25])), "rng": rng}


def note_sigmas(causes, tolerances):
    """Writes into causes of nominal numbers by how many tolerances they are off."""
    keys = {"loop_gain": "GAIN", "velocity_limit": "SPEED_LIMIT", "torque_limit": "TORQUE_LIMIT"}
    for c in causes:
        e, v = c["effect"], c["values"]
        first = next(iter(v.values()))
        each = first.get("by_joint", {})
        if e in keys:
            key = keys[e]
            nominal = lambda j: R.NOMINAL[key][int(j) in R.INTER]
            off = [abs((x * nominal(j) if e == "loop_gain" else x) - nominal(j)) / tolerances[key][int(j) in R.INTER] for j, x in each.items()]
            c["sigmas"] = max(off)
        elif e in ("motor_constant", "winding_resistance"):
            c["sigmas"] = max(abs(x - 1) / R.MOTOR["TORQUE_PER_AMP" if e == "motor_constant" else "OHM"] for x in each.values())
        elif e == "supply_voltage":
            c["sigmas"] = abs(first["value"] / R.VOLTS - 1) / R.MOTOR["VOLTS"]
        elif e == "ground_friction":
            c["sigmas"] = abs(first["value"] - 1) / tolerances["friction"]
        elif e == "restitution":
            c["sigmas"] = abs(first["value"] - R.BOUNCE) / tolerances["bounce"]
        elif e == "mass":
            c["sigmas"] = abs(first["value"] - 1) * R.HALF_KG * math.sqrt(8) / tolerances["mass"]


def generate(engine, out, seed, number, kind, most):
    """One robot: its folder and its label; a robot that falls apart is drawn again."""
    for attempt in range(6):
        d = draw(engine, seed, number + 100000 * attempt, kind)
        label = play_all(engine, out, number, d, most)
        if label:
            return label
    raise SystemExit(f"robot {number} cannot be played")


def with_rival(robot, rival):
    """A robot with one more cause."""
    out = robot.copy()
    R.plant(out, rival)
    return out


def note_evidence(d, causes, clean, forked, sizes, scale):
    """Writes into the causes how much of them shows. `sizes`: how many of the forks are alike, without a cause, with a rival in its place."""
    by = [[f[k] for f in forked] for k in range(len(forked[0]))]
    alike, less, rivals = sizes
    parts, at = [by[:alike], by[alike: alike + less]], alike + less
    beside = []
    for n in rivals:
        beside.append(by[at: at + n])
        at += n
    found = recording.evidence(clean, *parts, beside, by[at:], d["columns"], d["noise"], d["base_every"], d["rate"])
    for c, (full, left, rival) in zip(causes, found):
        c["delta_chi2"], c["delta_chi2_refitted"] = round(scale * full, 2), round(scale * left, 2)
        if rival is not None:
            c["delta_chi2_rival"] = round(scale * rival, 2)


def play_all(engine, out, number, d, most):
    """Plays and writes a drawn robot."""
    rng, causes, rate, contact = d["rng"], d["causes"], d["rate"], d["contact"]
    healthy, robot = d["robot"], d["robot"].copy()
    for c in causes:
        R.plant(robot, c)
    note_sigmas(causes, d["tolerances"])
    less = []
    for c in causes:
        r = healthy.copy()
        for other in causes:
            if other is not c:
                R.plant(r, other)
        less.append(r)
    alike, rivals = repeats(engine, robot, contact), [[with_rival(r, x) for x in R.rivals(c)] for c, r in zip(causes, less)]
    others = [*alike, *less, *(r for one in rivals for r in one), *off_nominal(robot, d["tolerances"])] if causes else []
    name = f"r{number:04}"
    gaits, seconds = int(rng.integers(most[0], most[1] + 1)), float(rng.choice([10.0, 11.0, 12.0]))
    text = ["format = 1", 'robot = "metamodule"', f'name = "{name}"']
    files = {}
    if d["measured"]:
        text += ["[metamodule]", 'model = "model.toml"']
        files["model.toml"] = recording.model_text(d["tolerances"])
    clean, forked = [], []
    for g in range(gaits):
        at = recording.gait(rng, seconds)
        for r in range(2):
            ask = others if r == 0 and g < 2 else ()
            log, logs = run(engine, robot, contact, at, seconds, rate, rng, ask)
            if log is None:
                return None
            if ask:
                again = np.arange(len(log)) // rate % 2 == 0
                clean.append(log[again])
                forked.append([x[again] for x in logs])
            files[f"g{g:02}_{r}.csv"] = recording.csv(log, at, d["columns"], d["noise"], d["base_every"], rng)
            text += ["", "[[run]]", f'file = "g{g:02}_{r}.csv"', f'gait = "g{g:02}"']
    if causes:
        note_evidence(d, causes, clean, forked, [len(alike), len(less), [len(x) for x in rivals]], 2 * gaits)
    files["dataset.toml"] = "\n".join(text) + "\n"
    folder = Path(out) / "cases" / name
    folder.mkdir(parents=True, exist_ok=True)
    for file, body in files.items():
        (folder / file).write_text(body)
    return {"name": name, "engine": engine.name, "kind": d["kind"], "causes": causes, "columns": [k for k, v in d["columns"].items() if v], "noise": d["noise"],
            "stated": "measured" if d["measured"] else "shipped", "rate_hz": rate, "gaits": gaits, "seconds": seconds, "contact": contact, "style": d["style"],
            "nominal": {"joints": {k: healthy.joints[:, i].tolist() for k, i in R.JOINT.items() if k in R.NOMINAL}, "volts": healthy.robot[0], "friction": healthy.friction,
                        "bounce": healthy.bounce, "halves_kg": healthy.halves_kg.tolist()}}


def main(text, make):
    """The command of an engine that `make` gives."""
    a = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    a.add_argument("out")
    a.add_argument("--robots", type=int, default=60)
    a.add_argument("--first", type=int, default=0)
    a.add_argument("--seed", type=int, default=1)
    a.add_argument("--kind", choices=["null", "single", "several", "outside"])
    a.add_argument("--gaits", default="6,8")
    args = a.parse_args()
    out = Path(args.out)
    (out / "parts").mkdir(parents=True, exist_ok=True)
    engine = make(out)
    most = [int(x) for x in args.gaits.split(",")]
    labels = []
    for number in range(args.first, args.first + args.robots):
        part = out / "parts" / f"r{number:04}.json"
        if not part.exists():
            start = time.perf_counter()
            label = generate(engine, out, args.seed, number, args.kind, most)
            part.write_text(json.dumps(label))
            said = " + ".join(f"{c['effect']}/{c['scope']} {c['delta_chi2']:.0f}>{c['delta_chi2_refitted']:.0f}>{c.get('delta_chi2_rival', -1):.0f}" for c in label["causes"])
            print(f"{label['name']} {time.perf_counter() - start:.1f} s {label['kind']} {said}", flush=True)
        labels.append(json.loads(part.read_text()))
    print("labels", recording.write_labels(out / "labels.json", labels))
