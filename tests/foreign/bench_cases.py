"""The cases of `bench_reality.py`, by name.

    bench_cases.py FOLDER [NAME...]      # writes those named, or all, and their labels
"""

import dataclasses

from bench_reality import Case, Joint, Record

POSITION_ONLY = Record(columns=("position",), rate_hz=50.0)
DRIVE = dict(kind="p", output="duty", kp=3.0, limit=1.0)
EFFORT = dict(kind="pid", output="effort", kp=6.0, ki=0.0, kd=0.25, limit=1.6)
CASCADE = dict(kind="cascade", output="voltage", kp=12.0, kv=2.0, limit=7.4)
VELOCITY = dict(kind="p", output="velocity", kp=10.0, limit=6.0)


def cases():
    """All cases."""
    out = []

    def add(name, truth=(), record=None, nominal=None, **more):
        fields = Case.__dataclass_fields__
        joint = Joint(**{k: v for k, v in more.items() if k not in fields})
        rest = {k: v for k, v in more.items() if k in fields}
        out.append(Case(name, joint, record or Record(), tuple(truth), nominal or {}, **rest))

    # Nulls, in every dress that the format allows.
    add("null_duty", **DRIVE)
    add("null_pid_effort", **EFFORT)
    add("null_pid_integral", kind="pid", output="effort", kp=6.0, ki=8.0, kd=0.25, limit=1.6)
    add("null_cascade", **CASCADE)
    add("null_velocity", **VELOCITY)
    add("null_slow_controller", **{**DRIVE, "period": 0.01})
    add("null_no_tolerance", write_tolerance=False, **DRIVE)
    add("null_position_only", record=POSITION_ONLY, **DRIVE)
    add("null_no_repeats", repeats=1, **DRIVE)
    add("null_irregular", record=Record(row_jitter=0.3, rate_hz=188.0, own_rows=True), **DRIVE)
    add("null_enable", enable=lambda t: not 3.0 < t < 4.0, **DRIVE)
    add("null_gains", overrides=lambda g, r, j: _gain(j, (2.0, 3.0, 5.0)[g % 3]), **DRIVE)
    add("null_bus_1hz", record=Record(bus_hz=1.0, rate_hz=50.0, own_rows=True), **DRIVE)
    add("null_linear", motion="linear", kind="pid", output="effort", inertia=1.2, gravity=0.0, stall=40.0, speed=0.6, kp=900.0, kd=60.0,
        limit=40.0, supply=24.0, size=0.1, disturbance=0.02, record=Record(encoder=1e-5, columns=("position", "velocity", "current")))
    add("null_effort_command", command="effort", output="effort", viscous=0.0, size=0.15, gravity=0.4, kind="p",
        record=Record(columns=("position", "velocity")), known=("inertia", "gravity"))
    add("null_voltage_command", command="voltage", output="voltage", size=3.0, alias="setpoint_v")
    add("null_unknown_controller", known=("inertia", "gravity"), record=POSITION_ONLY, **DRIVE)
    add("null_nothing_known", known=(), record=POSITION_ONLY, gravity=0.0, **DRIVE)
    # One cause each.
    add("coulomb_lugre", ("coulomb_friction",), coulomb=0.08, **DRIVE)
    add("coulomb_mujoco", ("coulomb_friction",), coulomb=0.08, coulomb_law="mujoco", **DRIVE)
    add("coulomb_effort", ("coulomb_friction",), coulomb=0.08, **EFFORT)
    add("coulomb_position_only", ("coulomb_friction",), coulomb=0.1, record=POSITION_ONLY, **DRIVE)
    add("coulomb_unsigned", ("coulomb_friction",), coulomb=0.1, record=Record(columns=("position", "current_abs")), **DRIVE)
    add("coulomb_renamed", ("coulomb_friction",), coulomb=0.1, rename={"setpoint_rad": "goal", "position_rad": "pos"},
        roles=lambda g, r: "check" if g == 2 else "fit", check_blind=True, **DRIVE)
    add("viscous", ("viscous_friction",), viscous=0.03, **DRIVE)
    add("viscous_effort", ("viscous_friction",), viscous=0.05, **EFFORT)
    add("viscous_effort_command", ("viscous_friction",), command="effort", output="effort", viscous=0.03, size=0.25, gravity=0.4,
        record=Record(columns=("position", "velocity")), known=("inertia", "gravity"))
    add("coulomb_voltage_command", ("coulomb_friction",), command="voltage", output="voltage", size=3.0, coulomb=0.1, alias="setpoint_v")
    add("stribeck", ("stribeck_friction",), static=0.12, coulomb=0.0, stribeck_speed=0.15, **DRIVE)
    add("load_friction", ("load_dependent_friction",), load_share=0.25, **DRIVE)
    add("asymmetric", ("asymmetric_friction",), asymmetry=0.1, coulomb=0.0, **DRIVE)
    add("quadratic", ("quadratic_friction",), quadratic=0.01, **DRIVE)
    add("ripple", ("torque_ripple",), ripple=0.06, ripple_periods=8.0, **DRIVE)
    add("latency_40", ("latency",), latency=0.04, **DRIVE)
    add("latency_12_cascade", ("latency",), latency=0.012, **CASCADE)
    add("latency_velocity", ("latency",), latency=0.05, **VELOCITY)
    add("latency_position_only", ("latency",), latency=0.05, record=POSITION_ONLY, **DRIVE)
    add("feedback_delay", ("feedback_delay",), feedback_delay=0.015, **DRIVE)
    add("motor_lag", ("motor_lag",), lag=0.03, **DRIVE)
    add("deadband", ("deadband",), deadband=0.03, **DRIVE)
    add("deadband_position_only", ("deadband|backlash|stribeck_friction",), deadband=0.04, record=POSITION_ONLY, **DRIVE)
    add("velocity_limit", ("velocity_limit",), slew=1.5, **DRIVE)
    add("velocity_limit_velocity", ("velocity_limit",), nominal={"speed": 6.0, "limit": 6.0}, **{**VELOCITY, "limit": 1.5})
    add("torque_limit", ("torque_limit|current_limit",), torque_limit=0.5, **DRIVE)
    add("current_limit", ("torque_limit|current_limit",), current_limit=0.6, **DRIVE)
    add("derating", ("thermal_derating",), derate_share=0.3, derate_time=6.0, seconds=16.0, repeats=1, **DRIVE)
    add("sag", ("supply_sag",), sag=1.5, **DRIVE)
    add("supply_low", ("supply_voltage",), supply=5.8, nominal={"supply": 7.4}, **DRIVE)
    add("inertia_40", ("inertia",), inertia=0.008, nominal={"inertia": 0.005}, **EFFORT)
    add("gravity_30", ("gravity_load",), gravity=0.55, nominal={"gravity": 0.4}, **DRIVE)
    add("gain_low", ("loop_gain",), **{**DRIVE, "kp": 2.2}, nominal={"kp": 3.0})
    add("damping_gain", ("damping_gain",), **{**EFFORT, "kd": 0.4}, nominal={"kd": 0.25})
    add("offset", ("joint_offset",), offset=0.06, **DRIVE)
    add("scale", ("joint_scale",), scale=1.06, **DRIVE)
    add("sign", ("joint_sign",), scale=-1.0, **DRIVE)
    add("quantisation", ("quantisation",), quantum=0.05, record=Record(echo=True), **DRIVE)
    add("skew", ("clock_skew",), skew=0.01, seconds=12.0, **DRIVE)
    add("loss", ("packet_loss",), loss=0.25, setpoint_hz=20.0, record=Record(echo=True), **DRIVE)
    add("jitter", ("jitter",), jitter=0.015, setpoint_hz=20.0, record=Record(echo=True), **DRIVE)
    add("backlash_link", ("backlash",), play=0.02, record=Record(columns=("position", "link", "current")), **DRIVE)
    add("compliance_link", ("compliance",), stiffness=12.0, record=Record(columns=("position", "link", "current")), **DRIVE)
    add("linear_coulomb", ("coulomb_friction",), motion="linear", kind="pid", output="effort", inertia=1.2, gravity=0.0, stall=40.0, speed=0.6,
        kp=900.0, kd=60.0, limit=40.0, supply=24.0, size=0.1, disturbance=0.02, coulomb=4.0,
        record=Record(encoder=1e-5, columns=("position", "velocity", "current")))
    # Two and three.
    add("coulomb_latency", ("coulomb_friction", "latency"), coulomb=0.1, latency=0.04, **DRIVE)
    add("viscous_deadband", ("viscous_friction", "deadband"), viscous=0.03, deadband=0.03, **DRIVE)
    add("coulomb_offset_sag", ("coulomb_friction", "joint_offset", "supply_sag"), coulomb=0.1, offset=0.08, sag=1.5, **DRIVE)
    # Outside the library.
    add("hardening", ("unknown",), hardening=0.5, **DRIVE)
    add("position_friction", ("unknown",), position_friction=0.25, **DRIVE)
    return out


def _gain(j, kp):
    j.kp = kp
    return [f"bench.controller.kp = {kp}"]


def by_name(name):
    """The case of that name, fresh."""
    return next(dataclasses.replace(c) for c in cases() if c.name == name)


if __name__ == "__main__":
    import sys
    from pathlib import Path

    from bench_reality import generate

    for wanted in sys.argv[2:] or [c.name for c in cases()]:
        generate(by_name(wanted), Path(sys.argv[1]) / wanted, 1)
