#include "law.h"
#include <math.h>
#include <string.h>

static double clamp(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

static int loose(const double *p) { return p[STIFFNESS] > 0 || p[PLAY] > 0; }

void motor_start(Motor *m, const double *p, double angle) {
    memset(m, 0, sizeof *m);
    m->rotor = angle;
    m->goal = angle;
    for (int k = 0; k < DELAY_MAX; k++) m->seen[k] = angle;
}

double motor_encoder(const Motor *m, const double *p, double t) {
    double q = m->rotor;
    return q + p[ECCENTRIC] * sin(p[ECCENTRIC_PERIODS] * q) + p[DRIFT] * (t + 2.0);
}

double wire_reading(const double *p, double angle) {
    return p[READINGS_TOO] > 0 ? (angle - p[OFFSET]) / (p[SIGN] * p[SCALE]) - p[HOMING] : angle - p[HOMING];
}

double wire_speed(const double *p, double speed) { return p[READINGS_TOO] > 0 ? speed / (p[SIGN] * p[SCALE]) : speed; }

double angle_of_reading(const double *p, double reading) {
    return p[READINGS_TOO] > 0 ? p[SIGN] * p[SCALE] * (reading + p[HOMING]) + p[OFFSET] : reading + p[HOMING];
}

void motor_receive(Motor *m, const double *p, const Schedule *s, double t) {
    while (m->sent + 1 < s->count && s->due[m->sent + 1] <= t + 1e-9) m->sent++;
    m->wire = s->value[m->sent];
    m->goal = p[SIGN] * p[SCALE] * (m->wire + p[HOMING]) + p[OFFSET];
}

// Friction of the gear: bristles that bend up to what the Stribeck curve allows. `load` is what the gear carries.
static double friction(Motor *m, const double *p, double w, double load, double dt) {
    double rest = p[STRIBECK_SPEED] > 0 ? exp(-pow(fabs(w) / p[STRIBECK_SPEED], p[STRIBECK_POWER])) : 0;
    double level = p[COULOMB] + p[STATIC] * rest + p[LOAD_SHARE] * fabs(load) + p[ASYMMETRY] * tanh(w / 0.02);
    if (p[ROUGH] > 0) level += p[ROUGH] * 0.5 * (1 + sin(p[ROUGH_PERIODS] * m->rotor));
    if (level < 0) level = 0;
    double most = p[COULOMB] + p[STATIC] + fabs(p[ASYMMETRY]) + p[ROUGH] + p[LOAD_SHARE] * fabs(load);
    double wet = (p[VISCOUS] + p[DAMPING] + p[QUADRATIC] * fabs(w)) * w;
    if (most <= 0) return wet;
    double stiff = most / p[BRISTLE], bent = level / stiff;
    // Exact over a step of constant speed.
    double end = bent > 0 ? (w > 0 ? bent : w < 0 ? -bent : m->bristle) : 0;
    double keep = bent > 1e-12 ? exp(-fabs(w) * dt / bent) : 0;
    m->bristle = end + (m->bristle - end) * keep;
    return stiff * m->bristle + wet;
}

// Torques that the gear adds by place.
static double by_place(const Motor *m, const double *p) {
    return p[RIPPLE] * sin(p[RIPPLE_PERIODS] * m->rotor + p[RIPPLE_PHASE]) + p[ECCENTRIC_NM] * cos(p[ECCENTRIC_PERIODS] * m->rotor)
        - p[TETHER] * (m->rotor - p[TETHER_REST]);
}

static double strongest(const Motor *m, const double *p) {
    double limit = p[TORQUE_LIMIT];
    if (p[CURRENT_LIMIT] > 0) limit = fmin(limit, p[CURRENT_LIMIT] * p[TORQUE_PER_AMP]);
    return limit * (1 - p[HEAT_FRACTION] * fmin(m->heat, 1));
}

static double spring(const double *p, double twist, double slip) {
    double beyond = twist - clamp(twist, -p[PLAY], p[PLAY]);
    if (beyond == 0) return 0;
    double torque = (p[STIFFNESS] > 0 ? p[STIFFNESS] : 800) * beyond + p[TWIST_DAMPING] * slip;
    return p[PLAY] > 0 && torque * beyond < 0 ? 0 : torque;
}

// Current, duty and heat of a torque.
static void load_up(Motor *m, const double *p, double bus, double speed, double dt) {
    m->amps = m->torque / p[TORQUE_PER_AMP];
    m->duty = clamp((p[OHM] * m->amps + p[TORQUE_PER_AMP] * speed) / bus, -1, 1);
    m->steady += (m->torque - m->steady) * fmin(dt / 0.015, 1);
    if (p[HEAT_TIME] > 0) {
        double r = m->amps / p[HEAT_CURRENT];
        m->heat += (r * r - m->heat) * dt / p[HEAT_TIME];
    }
}

Order motor_order(Motor *m, const double *p, double bus, double link, double link_speed, double t, double dt) {
    if (!loose(p)) {
        m->rotor = link;
        m->rotor_speed = link_speed;
    }
    // The servo reads at every step; readings are late by whole and parts of steps.
    m->newest = (m->newest + 1) % DELAY_MAX;
    m->seen[m->newest] = motor_encoder(m, p, t);
    double back = fmin(p[FEEDBACK_DELAY] / dt, DELAY_MAX - 2);
    int whole = (int)back;
    double a = m->seen[(m->newest + DELAY_MAX - whole) % DELAY_MAX], b = m->seen[(m->newest + DELAY_MAX - whole - 1) % DELAY_MAX];
    double error = m->goal - (a + (b - a) * (back - whole));
    error -= clamp(error, -p[DEADBAND], p[DEADBAND]);
    double v = p[GAIN] * error;
    if (p[ONE_SIDED] != 0) v *= v > 0 ? 1 + 0.5 * p[ONE_SIDED] : 1 - 0.5 * p[ONE_SIDED];
    v = clamp(v, -p[SPEED_LIMIT], p[SPEED_LIMIT]);
    m->asked = p[LAG] > 0 ? v + (m->asked - v) * exp(-dt / p[LAG]) : v;
    double wanted = m->asked - p[DROOP] * m->steady;
    // Full duty: V = R i + k w.
    double free_speed = bus / p[TORQUE_PER_AMP], lost = p[OHM] * m->steady / (p[TORQUE_PER_AMP] * p[TORQUE_PER_AMP]);
    Order o = {0};
    o.speed = clamp(wanted, -free_speed - lost, free_speed - lost);
    o.limit = strongest(m, p);
    o.loose = loose(p);
    double gear = by_place(m, p) - friction(m, p, m->rotor_speed, m->torque, dt);
    if (!o.loose) {
        o.torque = gear;
        return o;
    }
    double s = spring(p, m->rotor - link, m->rotor_speed - link_speed);
    double need = p[ROTOR] * (o.speed - m->rotor_speed) / dt + s - gear;
    m->torque = clamp(need, -o.limit, o.limit);
    m->rotor_speed += dt * (m->torque - s + gear) / p[ROTOR];
    m->rotor += dt * m->rotor_speed;
    m->link_nm = s;
    o.torque = s;
    load_up(m, p, bus, m->rotor_speed, dt);
    return o;
}

void motor_follow(Motor *m, const double *p, double bus, double link, double link_speed, double torque, double dt) {
    if (loose(p)) return;
    m->rotor = link;
    m->rotor_speed = link_speed;
    m->torque = torque;
    load_up(m, p, bus, link_speed, dt);
}
