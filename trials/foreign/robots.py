"""Robots with known causes, whatever engine plays them: what is wrong with them, what they are asked to do, what is recorded of them.

The laws of joints are in law.c; a module per engine plays them. Nothing here is shared with the diagnosis or with the emulated robot: the nominal
robot, the columns and the names of effects are the design's.
"""

import copy
import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
INTER = (1, 4)
KINDS = {"inter": (1, 4), "intra": (0, 2, 3, 5)}
MODULES = {"A": (0, 1, 2), "B": (3, 4, 5)}
EVERY = tuple(range(6))


def keys(name):
    """Index by name of an enumeration of law.h."""
    text = re.search(rf"enum {name} \{{(.*?)\}}", (HERE / "law.h").read_text(), re.S).group(1)
    names = re.findall(r"^\s*([A-Z_]+)\s*,?", text, re.M)
    return {n: i for i, n in enumerate(names)}


JOINT, ROBOT = keys("joint_key"), keys("robot_key")

# Table II, hand tuned, and Table I: values for intra- and inter-cube joints.
NOMINAL = {"GAIN": (10.0, 10.0), "SPEED_LIMIT": (2.5, 1.5), "TORQUE_LIMIT": (4.8, 3.2), "DAMPING": (0.0, 0.0), "TORQUE_PER_AMP": (12 / 2.786, 12 / 2.032), "OHM": (1.9, 4.09)}
FILE_KEYS = {"GAIN": "gain_per_s", "SPEED_LIMIT": "max_velocity_rad_s", "TORQUE_LIMIT": "max_torque_nm", "DAMPING": "damping_nm_s_rad"}
# 1 sigma: of the shipped model, and of a robot whose makers measured it. Motor constants and supply stand in no file:
# 3 %, 4 % and 1 %.
SHIPPED = {"GAIN": (1.0, 1.0), "SPEED_LIMIT": (0.25, 0.15), "TORQUE_LIMIT": (0.48, 0.32), "DAMPING": (0.05, 0.05), "friction": 0.2, "bounce": 0.2, "mass": 0.02}
MEASURED = {"GAIN": (0.3, 0.3), "SPEED_LIMIT": (0.08, 0.05), "TORQUE_LIMIT": (0.15, 0.1), "DAMPING": (0.02, 0.02), "friction": 0.05, "bounce": 0.05, "mass": 0.008}
MOTOR = {"TORQUE_PER_AMP": 0.03, "OHM": 0.04, "VOLTS": 0.01}
HALF_KG, VOLTS, FRICTION, BOUNCE = 0.325, 12.0, 1.0, 0.5


@dataclass
class Robot:
    """What a robot really is: numbers of law.h by joint, and its body and ground."""

    joints: np.ndarray
    robot: np.ndarray
    halves_kg: np.ndarray
    # Masses that the nominal robot has not: (body, kg, place in the body's frame).
    weights: list = field(default_factory=list)
    com_m: np.ndarray = field(default_factory=lambda: np.zeros(3))
    armature: np.ndarray = field(default_factory=lambda: np.zeros(6))
    friction: float = FRICTION
    anisotropy: tuple = (1.0, 0.0)
    torsion_m: float = 0.0
    bounce: float = BOUNCE
    slope: tuple = (0.0, 0.0)
    # Contacts' own frequency, rad/s: how stiff the ground is.
    contact_rad_s: float = 200.0
    order: tuple = EVERY
    clock: float = 1.0
    latency: np.ndarray = field(default_factory=lambda: np.zeros(6))
    jitter: np.ndarray = field(default_factory=lambda: np.zeros(6))
    loss: np.ndarray = field(default_factory=lambda: np.zeros(6))
    step_rad: np.ndarray = field(default_factory=lambda: np.zeros(6))
    column_scale: dict = field(default_factory=dict)

    def copy(self):
        """A robot of its own."""
        return copy.deepcopy(self)

    def set(self, key, joints, values):
        """Sets a number of some joints."""
        for j, v in zip(joints, values):
            self.joints[j, JOINT[key]] = v

    def loose(self):
        """Whether something needs shorter steps."""
        return bool(self.joints[:, JOINT["PLAY"]].any() or self.joints[:, JOINT["STIFFNESS"]].any() or self.robot[ROBOT["LINK_STIFFNESS"]] > 0)


def nominal(tolerances, rng, style):
    """A robot without a cause; `rng` draws it within its tolerances, Gaussian and not cut off."""
    joints = np.zeros((6, len(JOINT) - 1))
    for key, (intra, inter) in NOMINAL.items():
        for kind, value in (("intra", intra), ("inter", inter)):
            if key in MOTOR:
                drawn = [value * (1 + MOTOR[key] * rng.normal()) for _ in KINDS[kind]]
            else:
                sigma = tolerances[key][kind == "inter"]
                common = rng.normal()
                drawn = [value + sigma * (0.95 * common + 0.3 * rng.normal()) for _ in KINDS[kind]]
            joints[list(KINDS[kind]), JOINT[key]] = np.abs(drawn)
    for key, value in (("SIGN", 1), ("SCALE", 1), ("ROTOR", style["rotor"]), ("BRISTLE", style["bristle"]), ("STRIBECK_POWER", style["power"]), ("TWIST_DAMPING", 0.3)):
        joints[:, JOINT[key]] = value
    robot = np.zeros(len(ROBOT) - 1)
    robot[ROBOT["VOLTS"]] = VOLTS * (1 + MOTOR["VOLTS"] * rng.normal())
    r = Robot(joints, robot, HALF_KG + tolerances["mass"] * rng.normal(size=8))
    r.friction = max(FRICTION + tolerances["friction"] * rng.normal(), 0.05)
    r.bounce = float(np.clip(BOUNCE + tolerances["bounce"] * rng.normal(), 0.02, 0.95))
    r.contact_rad_s = style["contact_rad_s"]
    return r


def log_uniform(rng, low, high, moderate):
    """Between the ends, or in the middle part of that where several causes meet."""
    a, b = (0.3, 0.75) if moderate else (0.0, 1.0)
    return math.exp(math.log(low) + (math.log(high) - math.log(low)) * rng.uniform(a, b))


# Effects of joints: stage, parameter's key, ends of its size, form, weight. Forms: plain, signed, ratio (exp of +-x),
# near (1 +- x).
# The low end is half of what a typical recording shows.
JOINT_EFFECTS = {
    "joint_sign": ("conventions", "sign", -1, -1, "plain", 0.6),
    "joint_scale": ("conventions", "ratio", 0.01, 0.3, "near", 1),
    "joint_offset": ("conventions", "offset_rad", 0.008, 0.4, "signed", 1.3),
    "latency": ("transport", "delay_s", 0.005, 0.15, "plain", 1.5),
    "jitter": ("transport", "sigma_s", 0.006, 0.06, "plain", 0.8),
    "packet_loss": ("transport", "probability", 0.02, 0.4, "plain", 0.8),
    "quantisation": ("transport", "step_rad", 0.006, 0.15, "plain", 0.7),
    "loop_gain": ("driver", "ratio", 0.15, 1.0, "ratio", 1),
    "deadband": ("driver", "half_width_rad", 0.003, 0.06, "plain", 0.8),
    "velocity_limit": ("driver", "limit_rad_s", 0.2, 1.3, "plain", 1),
    "feedback_delay": ("driver", "delay_s", 0.006, 0.06, "plain", 0.7),
    "motor_lag": ("driver", "time_constant_s", 0.006, 0.12, "plain", 0.9),
    "speed_droop": ("driver", "rad_s_nm", 0.02, 0.4, "plain", 0.5),
    "motor_constant": ("electrical", "ratio", 0.06, 0.5, "ratio", 0.7),
    "winding_resistance": ("electrical", "ratio", 0.08, 0.7, "ratio", 0.7),
    "current_limit": ("electrical", "limit_a", 0.08, 0.45, "plain", 0.5),
    "torque_limit": ("electrical", "limit_nm", 0.4, 2.2, "plain", 1),
    "thermal_derating": ("electrical", "fraction", 0.5, 0.9, "plain", 0.3),
    "coulomb_friction": ("drivetrain", "torque_nm", 0.03, 1.5, "plain", 2),
    "viscous_friction": ("drivetrain", "nm_s_rad", 0.04, 1.5, "plain", 1.3),
    "stribeck_friction": ("drivetrain", "static_nm", 0.08, 1.2, "plain", 0.8),
    "load_dependent_friction": ("drivetrain", "fraction", 0.04, 0.5, "plain", 0.7),
    "asymmetric_friction": ("drivetrain", "difference_nm", 0.08, 1.0, "signed", 0.7),
    "quadratic_friction": ("drivetrain", "nm_s2_rad2", 0.06, 1.5, "plain", 0.5),
    "torque_ripple": ("drivetrain", "amplitude_nm", 0.06, 0.7, "plain", 0.6),
    "inertia": ("drivetrain", "armature_kg_m2", 0.006, 0.1, "plain", 0.8),
    "backlash": ("transmission", "half_width_rad", 0.004, 0.08, "plain", 1.3),
    "compliance": ("transmission", "stiffness_nm_rad", 8, 200, "plain", 1),
}
ROBOT_EFFECTS = {
    "joint_order": ("conventions", None, 0, 0, "plain", 0.7),
    "clock_skew": ("transport", "ratio", 0.0006, 0.02, "near", 0.7),
    "supply_voltage": ("supply", "value_v", 0.03, 0.5, "volt", 0.8),
    "supply_sag": ("supply", "resistance_ohm", 0.08, 2.5, "plain", 0.7),
    "connector_compliance": ("transmission", "stiffness_nm_rad", 3, 120, "plain", 0.9),
    "connector_play": ("transmission", "half_width_rad", 0.006, 0.12, "plain", 0.7),
    "ground_friction": ("body", "coefficient", 0.12, 1.3, "mostly_less", 1.5),
    "friction_anisotropy": ("body", "ratio", 0.15, 1.0, "ratio", 0.5),
    "torsional_friction": ("body", "coefficient_m", 0.002, 0.04, "plain", 0.6),
    "restitution": ("body", "coefficient", 0.03, 0.9, "plain", 0.3),
    "ground_slope": ("body", "roll_rad", 0.006, 0.12, "plain", 1.2),
    "ground_compliance": ("body", "stiffness_n_m", 400, 5000, "plain", 0.8),
    "mass": ("body", "ratio", 0.05, 0.45, "ratio", 1),
    "com_offset": ("body", "x_m", 0.004, 0.04, "plain", 0.8),
    "body_mass": ("body", "added_kg", 0.03, 0.4, "plain", 0.8),
    "payload": ("body", "added_kg", 0.06, 1.0, "plain", 1),
    "column_scale": ("conventions", "ratio", 0.05, 0.4, "near", 0.5),
}
OUTSIDE = {
    "position_friction": ("drivetrain", "torque_nm", 0.25, 1.5, "plain", 1),
    "gear_eccentricity": ("drivetrain", "angle_rad", 0.006, 0.05, "plain", 1),
    "zero_drift": ("conventions", "rad_s", 0.003, 0.03, "signed", 1),
    "asymmetric_gain": ("driver", "fraction", 0.15, 0.8, "signed", 1),
    "cable_tether": ("drivetrain", "stiffness_nm_rad", 0.3, 3.0, "plain", 1),
}
# What may be said for what is planted: physically the same, or the same in other words.
ALSO = {
    "viscous_friction": ["damping_gain"], "torque_limit": ["current_limit"], "current_limit": ["torque_limit"],
    "body_mass": ["payload", "mass", "com_offset"], "payload": ["body_mass", "mass", "com_offset"],
    "cable_tether": ["cable_tether"],
}


# What a cause may be taken for, where it sits.
RIVALS = {
    "joint_scale": ["loop_gain"], "joint_offset": ["backlash", "zero_drift"], "latency": ["feedback_delay", "motor_lag", "loop_gain"],
    "jitter": ["latency", "packet_loss"], "packet_loss": ["jitter", "latency"], "quantisation": ["deadband"], "loop_gain": ["motor_lag", "latency", "feedback_delay"],
    "deadband": ["backlash", "quantisation"], "velocity_limit": ["torque_limit", "loop_gain"], "feedback_delay": ["latency", "motor_lag", "loop_gain"],
    "motor_lag": ["latency", "feedback_delay", "loop_gain"], "speed_droop": ["loop_gain", "velocity_limit"], "motor_constant": ["winding_resistance", "supply_voltage"],
    "winding_resistance": ["motor_constant", "supply_voltage"], "current_limit": ["velocity_limit", "speed_droop"], "torque_limit": ["velocity_limit", "speed_droop"],
    "thermal_derating": ["torque_limit"], "coulomb_friction": ["viscous_friction", "load_dependent_friction", "stribeck_friction"],
    "viscous_friction": ["coulomb_friction", "quadratic_friction"], "stribeck_friction": ["coulomb_friction", "backlash"],
    "load_dependent_friction": ["coulomb_friction", "mass"], "asymmetric_friction": ["coulomb_friction", "cable_tether"],
    "quadratic_friction": ["viscous_friction", "coulomb_friction"], "torque_ripple": ["position_friction"], "inertia": ["motor_lag", "viscous_friction"],
    "backlash": ["deadband", "compliance", "joint_offset"], "compliance": ["backlash", "connector_compliance"], "clock_skew": ["latency"],
    "supply_voltage": ["supply_sag"], "supply_sag": ["supply_voltage"], "connector_compliance": ["connector_play", "compliance"],
    "connector_play": ["connector_compliance", "backlash"], "ground_friction": ["mass", "torsional_friction", "friction_anisotropy"],
    "friction_anisotropy": ["ground_friction", "torsional_friction"], "torsional_friction": ["ground_friction", "friction_anisotropy"],
    "restitution": ["ground_compliance"], "ground_slope": ["com_offset"], "ground_compliance": ["restitution", "ground_friction"],
    "mass": ["ground_friction", "load_dependent_friction"], "com_offset": ["ground_slope", "body_mass"], "body_mass": ["load_dependent_friction", "ground_slope"],
    "payload": ["load_dependent_friction", "ground_slope"],
}


def rivals(cause):
    """Small causes that this one may be taken for, on its joints, or on all where only the rival has joints."""
    out = []
    for effect in RIVALS.get(cause["effect"], []):
        stage, key, low, high, form, _ = (JOINT_EFFECTS | ROBOT_EFFECTS | OUTSIDE)[effect]
        rng = np.random.default_rng(1)
        # Where a large number is a small cause, its high end.
        v = value(rng, *((0.7 * high, high) if key in ("limit_rad_s", "limit_nm", "stiffness_nm_rad", "stiffness_n_m") else (2 * low, 4 * low)), form, False)
        rival = {"effect": effect, "stage": stage, "joints": [], "values": {}}
        if effect in ROBOT_EFFECTS:
            robot_values(rng, rival, key, v, False)
        else:
            rival["joints"] = cause["joints"] or list(EVERY)
            joints = [str(j) for j in rival["joints"]]
            rival["values"][key] = {"value": v, "by_joint": dict.fromkeys(joints, v)}
            if effect in SECOND:
                more = {"velocity_rad_s": 0.08, "periods": 6, "rest_rad": 0.2, "time_constant_s": 4.0}[SECOND[effect][0]]
                rival["values"][SECOND[effect][0]] = {"value": more, "by_joint": dict.fromkeys(joints, more)}
            if effect == "torque_ripple":
                rival["values"]["phase_rad"] = {"value": 0.0, "by_joint": dict.fromkeys(joints, 0.0)}
        out.append(rival)
    return out


def value(rng, low, high, form, moderate):
    """A size in its form."""
    if form == "plain" and low < 0:
        return low
    x = log_uniform(rng, low, high, moderate)
    sign = rng.choice([-1.0, 1.0])
    # Drawn whatever the form, so that a seed keeps its robots.
    less = -x if rng.random() < 0.75 else min(x, 0.9)
    forms = {"plain": lambda: x, "signed": lambda: sign * x, "ratio": lambda: math.exp(sign * x), "near": lambda: 1 + sign * x, "volt": lambda: VOLTS * math.exp(-x),
             "mostly_less": lambda: math.exp(less)}
    return forms[form]()


def scope_of(rng, effect):
    """Scope and joints of a joint effect."""
    x = rng.random()
    if effect == "joint_sign":
        x *= 0.4 if x < 0.9 else 1
    if x < 0.38:
        return "joint", (int(rng.integers(6)),)
    if x < 0.76 and effect != "joint_sign":
        return "all", EVERY
    if x < 0.88:
        return "kind", KINDS[rng.choice(["inter", "intra"])]
    return "module", MODULES[rng.choice(["A", "B"])]


def spread_over(rng, joints, v, form, low):
    """Values of the joints of a cause: one, or one and a spread."""
    if len(joints) == 1 or (form == "plain" and low < 0):
        return [v] * len(joints), 0.0
    spread = 0.0 if rng.random() < 0.35 else rng.uniform(0.05, 0.4)
    factor = np.exp(spread * rng.normal(size=len(joints)))
    if form == "ratio":
        return [v**f for f in factor], spread
    if form == "near":
        return [1 + (v - 1) * f for f in factor], spread
    if form == "signed":
        return [v * f * s for f, s in zip(factor, rng.choice([-1.0, 1.0], size=len(joints)))], max(spread, 1.0)
    return [v * f for f in factor], spread


def draw_cause(rng, table, moderate, taken):
    """A cause: effect, scope, joints, values by key and joint."""
    names = [n for n in table if n not in taken]
    weights = np.array([table[n][5] for n in names])
    effect = str(rng.choice(names, p=weights / weights.sum()))
    stage, key, low, high, form, _ = table[effect]
    cause = {"effect": effect, "stage": stage, "also": ALSO.get(effect, []), "values": {}}
    if effect in ROBOT_EFFECTS:
        cause |= {"scope": "robot", "joints": []}
        robot_values(rng, cause, key, value(rng, low, high, form, moderate) if key else None, moderate)
        return cause
    if effect in OUTSIDE:
        scope, joints = "joint", (int(rng.integers(6)),)
    else:
        scope, joints = scope_of(rng, effect)
    v = value(rng, low, high, form, moderate)
    each, spread = spread_over(rng, joints, v, form, low)
    cause |= {"scope": scope, "joints": list(joints), "spread": spread}
    cause["values"][key] = {"value": v, "by_joint": {str(j): float(x) for j, x in zip(joints, each)}}
    more = {"stribeck_friction": ("velocity_rad_s", 0.03, 0.2), "torque_ripple": ("periods", 3, 20), "thermal_derating": ("time_constant_s", 2, 8),
            "position_friction": ("periods", 3, 12), "gear_eccentricity": ("periods", 3, 20), "cable_tether": ("rest_rad", 0.05, 0.8)}.get(effect)
    if more:
        x = log_uniform(rng, more[1], more[2], False)
        x = round(x) if more[0] == "periods" else x
        cause["values"][more[0]] = {"value": x, "by_joint": {str(j): x for j in joints}}
    if effect == "torque_ripple":
        cause["values"]["phase_rad"] = {"value": None, "by_joint": {str(j): float(rng.uniform(0, 6.28)) for j in joints}}
    if effect.startswith("joint_"):
        cause["readings_too"] = bool(rng.random() < 0.3)
    return cause


def robot_values(rng, cause, key, v, moderate):
    """Values of a cause that the robot has once."""
    values, effect = cause["values"], cause["effect"]
    if key:
        values[key] = {"value": v}
    if effect == "joint_order":
        order = list(EVERY)
        if rng.random() < 0.75:
            a, b = rng.choice(6, 2, replace=False)
            order[a], order[b] = order[b], order[a]
        else:
            order = [3, 4, 5, 0, 1, 2] if rng.random() < 0.5 else [int(k) for k in rng.permutation(6)]
            if order == list(EVERY):
                order = [3, 4, 5, 0, 1, 2]
        values["permutation"] = {"value": [int(k) for k in order]}
    elif effect == "friction_anisotropy":
        values["direction_rad"] = {"value": float(rng.uniform(0, math.pi))}
    elif effect == "ground_slope":
        a = rng.uniform(0, 2 * math.pi)
        values["roll_rad"], values["pitch_rad"] = {"value": v * math.cos(a)}, {"value": v * math.sin(a)}
    elif effect == "com_offset":
        way = rng.normal(size=3)
        way *= v / np.linalg.norm(way)
        for name, x in zip("xyz", way):
            values[f"{name}_m"] = {"value": float(x)}
    elif effect in ("body_mass", "payload"):
        body = int(rng.choice([0, 6] if effect == "body_mass" else [0, 3, 6]))
        values["body"] = {"value": body}
        place = np.zeros(3)
        if effect == "payload":
            place = rng.normal(size=3)
            place *= rng.uniform(0.02, 0.055) / np.linalg.norm(place)
        values["place_m"] = {"value": [float(x) for x in place]}
    elif effect == "column_scale":
        values["column"] = {"value": None}


def worn_gear(rng, moderate):
    """Play and dry friction in the same gears: a compound."""
    scope, joints = scope_of(rng, "backlash")
    out = []
    for effect in ("backlash", "coulomb_friction"):
        stage, key, low, high, form, _ = JOINT_EFFECTS[effect]
        v = value(rng, 2 * low, high, form, True)
        each, spread = spread_over(rng, joints, v, form, low)
        out.append({"effect": effect, "stage": stage, "also": ["worn_gear"], "compound": "worn_gear", "scope": scope, "joints": list(joints), "spread": spread,
                    "values": {key: {"value": v, "by_joint": {str(j): float(x) for j, x in zip(joints, each)}}}})
    return out


def draw_causes(rng, kind):
    """Causes of a robot of this kind: null, single, several, outside."""
    library = JOINT_EFFECTS | ROBOT_EFFECTS
    if kind == "null":
        return []
    if kind == "outside":
        return [draw_cause(rng, OUTSIDE, False, ())]
    if kind == "single":
        # As many causes of joints as of the robot in its registry of effects; joints' twice as heavy.
        table = JOINT_EFFECTS if rng.random() < 0.62 else ROBOT_EFFECTS
        return [draw_cause(rng, table, False, ())]
    count = 2 if rng.random() < 0.6 else 3
    moderate = rng.random() < 0.6
    causes = []
    if rng.random() < 0.12:
        causes = worn_gear(rng, moderate)
    elif rng.random() < 0.08:
        for effect in ("supply_voltage", "supply_sag"):
            causes.append(draw_cause(rng, {effect: ROBOT_EFFECTS[effect]}, True, ()) | {"also": ["weak_battery"], "compound": "weak_battery"})
    clash = {"current_limit": "torque_limit", "torque_limit": "current_limit", "body_mass": "payload", "payload": "body_mass",
             "connector_play": "connector_compliance", "connector_compliance": "connector_play"}
    while len(causes) < count:
        taken = {c["effect"] for c in causes}
        taken |= {clash[e] for e in taken if e in clash}
        causes.append(draw_cause(rng, library, moderate, taken))
    return causes


JOINT_KEYS = {
    "joint_sign": "SIGN", "joint_scale": "SCALE", "joint_offset": "OFFSET", "deadband": "DEADBAND", "velocity_limit": "SPEED_LIMIT",
    "feedback_delay": "FEEDBACK_DELAY", "motor_lag": "LAG", "speed_droop": "DROOP", "current_limit": "CURRENT_LIMIT", "torque_limit": "TORQUE_LIMIT",
    "coulomb_friction": "COULOMB", "viscous_friction": "VISCOUS", "load_dependent_friction": "LOAD_SHARE", "asymmetric_friction": "ASYMMETRY",
    "quadratic_friction": "QUADRATIC", "torque_ripple": "RIPPLE", "backlash": "PLAY", "compliance": "STIFFNESS", "stribeck_friction": "STATIC",
    "position_friction": "ROUGH", "gear_eccentricity": "ECCENTRIC", "zero_drift": "DRIFT", "asymmetric_gain": "ONE_SIDED", "cable_tether": "TETHER",
    "thermal_derating": "HEAT_FRACTION",
}
RATIOS = {"loop_gain": "GAIN", "motor_constant": "TORQUE_PER_AMP", "winding_resistance": "OHM"}
SECOND = {"stribeck_friction": ("velocity_rad_s", "STRIBECK_SPEED"), "torque_ripple": ("periods", "RIPPLE_PERIODS"), "position_friction": ("periods", "ROUGH_PERIODS"),
          "gear_eccentricity": ("periods", "ECCENTRIC_PERIODS"), "cable_tether": ("rest_rad", "TETHER_REST"), "thermal_derating": ("time_constant_s", "HEAT_TIME")}


def plant(robot, cause):
    """Puts a cause into a robot. A ratio is one to the nominal value."""
    effect, joints, values = cause["effect"], cause["joints"], cause["values"]
    if joints:
        first = list(values)[0]
        each = [values[first]["by_joint"][str(j)] for j in joints]
        if effect in RATIOS:
            key = RATIOS[effect]
            each = [NOMINAL[key][j in INTER] * x for j, x in zip(joints, each)]
            robot.set(key, joints, each)
        elif effect in JOINT_KEYS:
            robot.set(JOINT_KEYS[effect], joints, each)
        elif effect == "inertia":
            robot.armature[joints] += each
        else:
            name = {"latency": "latency", "jitter": "jitter", "packet_loss": "loss", "quantisation": "step_rad"}[effect]
            getattr(robot, name)[joints] = each
        if effect in SECOND:
            name, key = SECOND[effect]
            robot.set(key, joints, [values[name]["by_joint"][str(j)] for j in joints])
        if effect == "torque_ripple":
            robot.set("RIPPLE_PHASE", joints, [values["phase_rad"]["by_joint"][str(j)] for j in joints])
        if effect == "thermal_derating":
            robot.set("HEAT_CURRENT", joints, [0.25] * len(joints))
        if effect == "gear_eccentricity":
            robot.set("ECCENTRIC_NM", joints, [8.0 * x for x in each])
        if cause.get("readings_too"):
            robot.set("READINGS_TOO", joints, [1.0] * len(joints))
        return
    plant_once(robot, effect, {k: v["value"] for k, v in values.items()})


def plant_once(robot, effect, v):
    """Puts a cause that a robot has once into it."""
    if effect == "joint_order":
        robot.order = tuple(v["permutation"])
    elif effect == "clock_skew":
        robot.clock = v["ratio"]
    elif effect == "supply_voltage":
        robot.robot[ROBOT["VOLTS"]] = v["value_v"]
    elif effect == "supply_sag":
        robot.robot[ROBOT["SAG"]] = v["resistance_ohm"]
    elif effect == "connector_compliance":
        robot.robot[ROBOT["LINK_STIFFNESS"]] = v["stiffness_nm_rad"]
        robot.robot[ROBOT["LINK_DAMPING"]] = 0.1 * math.sqrt(v["stiffness_nm_rad"])
    elif effect == "connector_play":
        robot.robot[ROBOT["LINK_STIFFNESS"]], robot.robot[ROBOT["LINK_PLAY"]], robot.robot[ROBOT["LINK_DAMPING"]] = 500, v["half_width_rad"], 1.0
    elif effect == "ground_friction":
        robot.friction = v["coefficient"] * FRICTION
    elif effect == "friction_anisotropy":
        robot.anisotropy = (v["ratio"], v["direction_rad"])
    elif effect == "torsional_friction":
        robot.torsion_m = v["coefficient_m"]
    elif effect == "restitution":
        robot.bounce = v["coefficient"]
    elif effect == "ground_slope":
        robot.slope = (v["roll_rad"], v["pitch_rad"])
    elif effect == "ground_compliance":
        # A robot of 2.6 kg stands on about three places.
        robot.contact_rad_s = math.sqrt(v["stiffness_n_m"] / (8 * HALF_KG / 3))
    elif effect == "mass":
        robot.halves_kg = robot.halves_kg * (v["ratio"] * 8 * HALF_KG / robot.halves_kg.sum())
    elif effect == "com_offset":
        robot.com_m = np.array([v["x_m"], v["y_m"], v["z_m"]])
    elif effect in ("body_mass", "payload"):
        robot.weights.append((v["body"], v["added_kg"], v["place_m"]))
    elif effect == "column_scale":
        robot.column_scale[v["column"]] = v["ratio"]
    else:
        raise ValueError(effect)
