"""Joints drawn at random for `bench_reality.py`: other plants, controllers, row rates, columns and sizes than `bench_cases.py`.

    bench_fresh.py FOLDER SEED FROM TO      # writes data sets FROM to TO - 1 of the seed, and their labels
"""

import math
import sys
from pathlib import Path

import numpy as np
from bench_reality import GAITS, Case, Joint, Record, generate

# Rotary joints: light and fast, as in `bench_cases.py`, heavy and slow, geared without gravity on another supply.
PLANTS = (
    dict(inertia=0.0009, gravity=0.07, stall=0.45, speed=14.0, supply=6.0),
    dict(inertia=0.005, gravity=0.4, stall=1.6, speed=8.0, supply=7.4),
    dict(inertia=0.07, gravity=2.2, stall=9.0, speed=4.5, supply=12.0),
    dict(inertia=0.02, gravity=0.0, stall=3.5, speed=3.5, supply=24.0),
)
CONTROLLERS = ("duty", "effort", "integral", "cascade", "velocity")
COLUMNS = (
    ("position", "velocity", "current", "duty", "bus_v"),
    ("position", "velocity", "current", "duty", "bus_v"),
    ("position", "current"),
    ("position", "velocity", "effort"),
    ("position", "current_abs"),
    ("position",),
)


def controller(kind, p, rng):
    """Gains that answer at 25 to 40 rad/s on the plant `p`."""
    w = rng.uniform(25.0, 40.0)
    if kind == "duty":
        return dict(kind="p", output="duty", kp=w * w * p["inertia"] / p["stall"], limit=1.0)
    if kind in ("effort", "integral"):
        kp = w * w * p["inertia"]
        ki = 2.0 * kp if kind == "integral" else 0.0
        return dict(kind="pid", output="effort", kp=kp, ki=ki, kd=1.4 * w * p["inertia"], limit=p["stall"])
    if kind == "cascade":
        return dict(kind="cascade", output="voltage", kp=0.4 * w, kv=2.5 * w * p["inertia"] * p["supply"] / p["stall"], limit=p["supply"])
    return dict(kind="p", output="velocity", kp=0.3 * w, limit=p["speed"])


def spread(rng, low, high):
    """Log-uniform."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def effects(p, c, rng):
    """Every cause that this joint can have: name -> (what is planted, what the file states instead)."""
    sign = rng.choice((-1.0, 1.0))
    out = {
        "latency": (dict(latency=spread(rng, 0.01, 0.08)), {}),
        "joint_offset": (dict(offset=sign * spread(rng, 0.02, 0.2)), {}),
        "joint_scale": (dict(scale=1.0 + sign * spread(rng, 0.02, 0.1)), {}),
        "deadband": (dict(deadband=spread(rng, 0.008, 0.05)), {}),
        "velocity_limit": (dict(slew=spread(rng, 0.6, 1.8)), {}),
        "loop_gain": (dict(kp=c["kp"]), {"kp": c["kp"] * (1.0 + sign * rng.uniform(0.15, 0.4))}),
    }
    if c["output"] == "velocity":
        return out
    speed = 2.0
    out |= {
        "coulomb_friction": (dict(coulomb=p["stall"] * spread(rng, 0.02, 0.1), coulomb_law=str(rng.choice(("lugre", "mujoco")))), {}),
        "viscous_friction": (dict(viscous=p["stall"] / speed * spread(rng, 0.02, 0.1)), {}),
        "load_dependent_friction": (dict(load_share=spread(rng, 0.08, 0.35)), {}),
        "quadratic_friction": (dict(quadratic=p["stall"] / speed**2 * spread(rng, 0.02, 0.1)), {}),
        "torque_ripple": (dict(ripple=p["stall"] * spread(rng, 0.02, 0.06), ripple_periods=float(rng.integers(6, 12))), {}),
        "asymmetric_friction": (dict(asymmetry=p["stall"] * spread(rng, 0.04, 0.1)), {}),
        "feedback_delay": (dict(feedback_delay=spread(rng, 0.004, 0.012)), {}),
        "motor_lag": (dict(lag=spread(rng, 0.005, 0.03)), {}),
        "inertia": (dict(inertia=p["inertia"]), {"inertia": p["inertia"] * (1.0 + sign * rng.uniform(0.25, 0.45))}),
        "unknown": (dict(position_friction=0.15 * p["stall"]), {}),
    }
    if p["gravity"] > 0.0:
        out["gravity_load"] = (dict(gravity=p["gravity"]), {"gravity": p["gravity"] * (1.0 + sign * rng.uniform(0.15, 0.4))})
    else:
        del out["load_dependent_friction"]
    if c["output"] == "duty":
        out["supply_voltage"] = (dict(supply=p["supply"]), {"supply": p["supply"] * (1.0 + sign * rng.uniform(0.15, 0.3))})
        out["supply_sag"] = (dict(sag=rng.uniform(0.15, 0.5) * resistance(p)), {})
    if c["kind"] in ("pid", "cascade"):
        gain = "kd" if c["kind"] == "pid" else "kv"
        out["damping_gain"] = ({gain: c[gain]}, {gain: c[gain] * (1.0 + sign * rng.uniform(0.2, 0.4))})
    return out


def resistance(p):
    """Winding resistance of the plant's motor, ohm."""
    return p["supply"] / p["speed"] * p["supply"] / p["stall"]


def columns(choice, c, name):
    """Columns of the recording; a cause that only the voltage shows needs it."""
    if name in ("supply_sag", "supply_voltage", "loop_gain", "damping_gain", "inertia"):
        return COLUMNS[0]
    if c["output"] in ("effort", "velocity") and "effort" not in choice:
        return tuple(x for x in choice if x not in ("duty", "bus_v"))
    return choice


def case(seed, k):
    """Case `k`: two in five without an effect, one in ten with two, the others with one."""
    rng = np.random.default_rng([seed, k])
    plant = PLANTS[rng.integers(len(PLANTS))]
    scale = spread(rng, 0.8, 1.25)
    p = {key: v * (scale if key in ("inertia", "gravity", "stall") else 1.0) for key, v in plant.items()}
    c = controller(str(rng.choice(CONTROLLERS)), p, rng)
    possible = effects(p, c, rng)
    kind = k % 10
    names = [] if kind < 4 else list(rng.choice(sorted(possible), 2 if kind == 9 else 1, replace=False))
    if "unknown" in names:
        names = ["unknown"]
    planted, nominal = {}, {}
    for n in names:
        planted |= possible[n][0]
        nominal |= possible[n][1]
    chosen = COLUMNS[rng.integers(len(COLUMNS))]
    for n in names:
        chosen = columns(chosen, c, n)
    chosen = chosen if names else columns(chosen, c, "")
    rate = float(rng.choice((50.0, 100.0, 200.0, 500.0)))
    record = Record(columns=chosen, rate_hz=rate, encoder=2 * math.pi / float(rng.choice((4096, 16384))))
    motions = tuple(str(g) for g in rng.permutation(GAITS)[:4])
    truth = tuple(names)
    out = Case(f"f{seed}_{k:02d}_{'_'.join(names) or 'null'}", Joint(**(p | c | planted)), record, truth, nominal)
    out.gaits, out.repeats, out.seconds = motions, 2, 8.0
    out.size = 0.7 if c["output"] == "effort" else 1.0
    out.disturbance = 0.001 * p["stall"]
    # A set-point that falls between two rows would not be in the file.
    out.setpoint_hz = min(rate, float(rng.choice((20.0, 50.0, 100.0))))
    out.tolerance = float(rng.choice((0.02, 0.05)))
    if chosen == ("position",) and truth == ("deadband",):
        out.truth = ("deadband|backlash|stribeck_friction",)
    return out


if __name__ == "__main__":
    root, seed = Path(sys.argv[1]), int(sys.argv[2])
    for k in range(int(sys.argv[3]), int(sys.argv[4])):
        drawn = case(seed, k)
        generate(drawn, root / drawn.name, seed)
