// One run of a robot in MuJoCo with the joint law of law.c in the loop; and, from its state at one second in two, what
// other robots would do for that second ("forks"), which tells how much a cause shows.
#include "law.h"
#include <math.h>
#include <mujoco/mujoco.h>
#include <stdlib.h>
#include <string.h>

// t, wire 6, reading 6, speed 6, torque 6, current 6, duty 6, bus, base 3 + 4, gyro 3, accelerometer 3, link 6
#define ROW 57

typedef struct {
    const mjModel *model;
    mjData *data;
    int angle[JOINTS], speed[JOINTS], wheel[JOINTS], tendon[JOINTS];   // addresses
    int link_angle[3], link_speed[3];                                  // of the connector, -1 = welded
    int base, gyro, accel;                                             // body; sensor addresses
    const double *joints;                                              // JOINTS x JOINT_KEYS
    const double *robot;
    Schedule schedule[JOINTS];
    double turn[4];                                                    // the world against the engine's axes
} Robot;

typedef struct {
    Robot *robot;
    Motor motor[JOINTS];
    double bus, t;
    double force[3];
    int forces;
} Run;

static const double *of(const Robot *r, int k) { return r->joints + k * JOINT_KEYS; }

static void connector(const Robot *r) {
    mjData *d = r->data;
    for (int k = 0; k < 3; k++) {
        if (r->link_angle[k] < 0) continue;
        double q = d->qpos[r->link_angle[k]], half = r->robot[LINK_PLAY];
        double beyond = q - (q < -half ? -half : q > half ? half : q);
        double torque = beyond == 0 ? 0 : -r->robot[LINK_STIFFNESS] * beyond - r->robot[LINK_DAMPING] * d->qvel[r->link_speed[k]];
        d->qfrc_applied[r->link_speed[k]] = half > 0 && torque * beyond > 0 ? 0 : torque;
    }
}

static void step(Run *run, const double *disturbance) {
    Robot *r = run->robot;
    mjData *d = r->data;
    mjModel *m = (mjModel *)r->model;
    double dt = m->opt.timestep, drawn = 0;
    for (int k = 0; k < JOINTS; k++) {
        const double *p = of(r, k);
        motor_receive(&run->motor[k], p, &r->schedule[k], run->t);
        Order o = motor_order(&run->motor[k], p, run->bus, d->qpos[r->angle[k]], d->qvel[r->speed[k]], run->t, dt);
        m->tendon_frictionloss[r->tendon[k]] = o.loose ? 0 : o.limit;
        d->qvel[r->wheel[k]] = o.loose ? d->qvel[r->speed[k]] : o.speed;
        d->qfrc_applied[r->speed[k]] = o.torque + disturbance[k];
    }
    connector(r);
    mj_step(m, d);
    double torque[JOINTS] = {0};
    for (int e = d->ne; e < d->ne + d->nf; e++)
        if (d->efc_type[e] == mjCNSTR_FRICTION_TENDON)
            for (int k = 0; k < JOINTS; k++)
                if (d->efc_id[e] == r->tendon[k]) torque[k] = d->efc_force[e];
    for (int k = 0; k < JOINTS; k++) {
        motor_follow(&run->motor[k], of(r, k), run->bus, d->qpos[r->angle[k]], d->qvel[r->speed[k]], torque[k], dt);
        drawn += run->motor[k].duty * run->motor[k].amps;
    }
    run->bus = fmax(r->robot[VOLTS] - r->robot[SAG] * drawn, 0.3 * r->robot[VOLTS]);
    for (int k = 0; k < 3; k++) run->force[k] += d->sensordata[r->accel + k];
    run->forces++;
    run->t += dt;
}

static void sample(Run *run, double *row) {
    Robot *r = run->robot;
    mjData *d = r->data;
    mj_kinematics(r->model, d);
    double *x = row;
    *x++ = run->t;
    for (int k = 0; k < JOINTS; k++) *x++ = run->motor[k].wire;
    for (int k = 0; k < JOINTS; k++) {
        double q = d->qpos[r->angle[k]];
        Motor now = run->motor[k];
        if (!(of(r, k)[STIFFNESS] > 0 || of(r, k)[PLAY] > 0)) now.rotor = q;
        *x++ = wire_reading(of(r, k), motor_encoder(&now, of(r, k), run->t));
    }
    for (int k = 0; k < JOINTS; k++) *x++ = wire_speed(of(r, k), run->motor[k].rotor_speed);
    for (int k = 0; k < JOINTS; k++) {
        double sign = of(r, k)[READINGS_TOO] > 0 ? of(r, k)[SIGN] : 1;
        x[0] = sign * run->motor[k].torque;
        x[6] = sign * run->motor[k].amps;
        x[12] = sign * run->motor[k].duty;
        x++;
    }
    x += 12;
    *x++ = run->bus;
    double place[3], attitude[4];
    mju_rotVecQuat(place, d->xpos + 3 * r->base, r->turn);
    mju_mulQuat(attitude, r->turn, d->xquat + 4 * r->base);
    for (int k = 0; k < 3; k++) *x++ = place[k];
    for (int k = 0; k < 4; k++) *x++ = attitude[k];
    for (int k = 0; k < 3; k++) *x++ = d->sensordata[r->gyro + k];
    for (int k = 0; k < 3; k++) *x++ = run->forces ? run->force[k] / run->forces : d->sensordata[r->accel + k];
    for (int k = 0; k < JOINTS; k++) *x++ = d->qpos[r->angle[k]];
    memset(run->force, 0, sizeof run->force);
    run->forces = 0;
}

// Goes on in another robot with the same readings and pose.
static void fork_to(const Run *from, Run *to) {
    Robot *a = from->robot, *b = to->robot;
    to->bus = from->bus;
    to->t = from->t;
    memset(to->force, 0, sizeof to->force);
    to->forces = 0;
    mju_zero(b->data->qacc_warmstart, b->model->nv);
    mju_zero(b->data->qfrc_applied, b->model->nv);
    mju_copy(b->data->qpos, a->data->qpos, 7);
    mju_copy(b->data->qvel, a->data->qvel, 6);
    b->data->time = a->data->time;
    for (int k = 0; k < JOINTS; k++) {
        const double *p = of(a, k), *n = of(b, k);
        to->motor[k] = from->motor[k];
        double q = a->data->qpos[a->angle[k]], moved = angle_of_reading(n, wire_reading(p, q)) - q;
        double factor = wire_speed(p, 1) / wire_speed(n, 1);
        b->data->qpos[b->angle[k]] = q + moved;
        b->data->qvel[b->speed[k]] = factor * a->data->qvel[a->speed[k]];
        to->motor[k].rotor += moved;
        to->motor[k].rotor_speed *= factor;
        for (int i = 0; i < DELAY_MAX; i++) to->motor[k].seen[i] += moved;
        to->motor[k].sent = 0;
    }
    for (int k = 0; k < 3; k++)
        if (b->link_angle[k] >= 0) {
            b->data->qpos[b->link_angle[k]] = a->link_angle[k] >= 0 ? a->data->qpos[a->link_angle[k]] : 0;
            b->data->qvel[b->link_speed[k]] = a->link_speed[k] >= 0 ? a->data->qvel[a->link_speed[k]] : 0;
        }
}

// A run of `rows` rows after `settle` seconds; disturbances in steps of 10 ms from the start of the settling. `others`
// play one second in two again, each under disturbances of its own; the rows of the rest stay as they are. Returns 1
// where the state became absurd, else 0.
int play(Robot *robot, double settle, double row_s, int rows, const double *disturbance, double *log, Robot **others, const double **others_disturbance, int count,
         double *other_logs) {
    Run run = {.robot = robot, .bus = robot->robot[VOLTS], .t = -settle};
    for (int k = 0; k < JOINTS; k++) {
        const double *p = of(robot, k);
        motor_start(&run.motor[k], p, robot->data->qpos[robot->angle[k]]);
    }
    double dt = robot->model->opt.timestep;
    int per_row = (int)lround(row_s / dt), per_second = (int)lround(1 / row_s);
    for (long n = 0, before = lround(settle / dt); n < before; n++) step(&run, disturbance + JOINTS * (int)(n * dt / 0.01));
    run.t = 0;
    memset(run.force, 0, sizeof run.force);
    run.forces = 0;
    for (int row = 0; row < rows; row++) {
        sample(&run, log + (long)row * ROW);
        if (row % (2 * per_second) == 0)
            for (int c = 0; c < count; c++) {
                Run other = {.robot = others[c]};
                fork_to(&run, &other);
                int steps = (int)lround(row_s / others[c]->model->opt.timestep);
                for (int i = row; i < row + per_second && i < rows; i++) {
                    sample(&other, other_logs + ((long)c * rows + i) * ROW);
                    for (int s = 0; s < steps; s++) step(&other, others_disturbance[c] + JOINTS * (int)((settle + other.t) / 0.01));
                }
            }
        for (int i = 0; i < per_row; i++) step(&run, disturbance + JOINTS * (int)((settle + run.t) / 0.01));
        for (int k = 0; k < robot->model->nq; k++)
            if (!isfinite(robot->data->qpos[k]) || fabs(robot->data->qpos[k]) > 1e3) return 1;
    }
    return 0;
}
