// One run of a robot in ODE with the joint law of law.c in the loop, and the forks that mujoco_play.c describes.
// Bodies are rigid, hinges have ODE's own motors, contacts are made from surface points below the ground, the deepest
// eight of a half-sphere.
#include "law.h"
#include <math.h>
#include <ode/ode.h>
#include <stdlib.h>
#include <string.h>

// As in mujoco_play.c.
#define ROW 57
#define BODIES 8
#define HALVES 8
#define PER_HALF 8

typedef struct {
    int bodies, quick;                                     // 7, or 8 where the connector is split: body 7 is its distal side
    double mass[BODIES], inertia[BODIES][6], com[BODIES][3];  // inertia xx yy zz xy xz yz about the centre of mass
    double origin[BODIES][3];                              // of the bodies' frames at home
    double place[BODIES][3], attitude[BODIES][4];          // of these frames at the start
    double axis[JOINTS][3], anchor[JOINTS][3];             // at home
    int child[JOINTS], parent[JOINTS], half_body[HALVES], points[HALVES];
    const double *point[HALVES];                           // from the body's frame
    double cube[2][3], ball;                               // of the outer cubes, from bodies 1 and 5: they may meet
    double split[3];                                       // place of the connector at home
    double gravity[3], friction[2], direction, torsion, bounce, stiffness, damping, step;
    const double *joints, *robot;
    Schedule schedule[JOINTS];
} Robot;

typedef struct {
    const Robot *robot;
    dWorldID world;
    dJointGroupID contacts;
    dBodyID body[BODIES];
    dJointID hinge[JOINTS], ball;
    dJointFeedback feedback[JOINTS];
    double angle[JOINTS], before[3];                       // whole angles; speed of the sensor's place one step ago
    Motor motor[JOINTS];
    double bus, t, force[3];
    int forces;
} Run;

static const double *of(const Robot *r, int k) { return r->joints + k * JOINT_KEYS; }

static void build(Run *run) {
    const Robot *r = run->robot;
    run->world = dWorldCreate();
    run->contacts = dJointGroupCreate(0);
    dWorldSetGravity(run->world, r->gravity[0], r->gravity[1], r->gravity[2]);
    dWorldSetCFM(run->world, 1e-8);
    dWorldSetERP(run->world, 0.2);
    dWorldSetQuickStepNumIterations(run->world, 60);
    for (int b = 0; b < r->bodies; b++) {
        dMass m;
        const double *i = r->inertia[b];
        dMassSetParameters(&m, r->mass[b], 0, 0, 0, i[0], i[1], i[2], i[3], i[4], i[5]);
        run->body[b] = dBodyCreate(run->world);
        dBodySetMass(run->body[b], &m);
        dBodySetPosition(run->body[b], r->origin[b][0] + r->com[b][0], r->origin[b][1] + r->com[b][1], r->origin[b][2] + r->com[b][2]);
        dBodySetGyroscopicMode(run->body[b], 1);
    }
    for (int k = 0; k < JOINTS; k++) {
        run->hinge[k] = dJointCreateHinge(run->world, 0);
        dJointAttach(run->hinge[k], run->body[r->child[k]], run->body[r->parent[k]]);
        dJointSetHingeAnchor(run->hinge[k], r->anchor[k][0], r->anchor[k][1], r->anchor[k][2]);
        dJointSetHingeAxis(run->hinge[k], r->axis[k][0], r->axis[k][1], r->axis[k][2]);
        dJointSetFeedback(run->hinge[k], &run->feedback[k]);
    }
    if (r->bodies > 7) {
        run->ball = dJointCreateBall(run->world, 0);
        dJointAttach(run->ball, run->body[7], run->body[3]);
        dJointSetBallAnchor(run->ball, r->split[0], r->split[1], r->split[2]);
    }
    for (int b = 0; b < r->bodies; b++) {
        dVector3 at;
        dBodySetQuaternion(run->body[b], r->attitude[b]);
        dBodySetPosition(run->body[b], 0, 0, 0);
        dBodyGetRelPointPos(run->body[b], r->com[b][0], r->com[b][1], r->com[b][2], at);
        dBodySetPosition(run->body[b], r->place[b][0] + at[0], r->place[b][1] + at[1], r->place[b][2] + at[2]);
    }
}

static void destroy(Run *run) {
    dJointGroupDestroy(run->contacts);
    dWorldDestroy(run->world);
}

static void touch(Run *run, const double at[3], double depth, const double normal[3], dBodyID a, dBodyID b) {
    const Robot *r = run->robot;
    dContact c;
    memset(&c, 0, sizeof c);
    c.surface.mode = dContactApprox1 | dContactMu2 | dContactFDir1 | dContactSoftERP | dContactSoftCFM | dContactBounce;
    c.surface.mu = r->friction[0];
    c.surface.mu2 = r->friction[1];
    double hk = r->step * r->stiffness;
    c.surface.soft_erp = hk / (hk + r->damping);
    c.surface.soft_cfm = 1 / (hk + r->damping);
    c.surface.bounce = r->bounce;
    c.surface.bounce_vel = 0.01;
    if (r->torsion > 0) {
        c.surface.mode |= dContactRolling;
        c.surface.rhoN = r->torsion;
    }
    c.fdir1[0] = cos(r->direction);
    c.fdir1[1] = sin(r->direction);
    if (b) {
        // Two cubes: any tangent.
        c.surface.mode &= ~dContactFDir1;
        c.surface.mu2 = r->friction[0];
    }
    for (int i = 0; i < 3; i++) {
        c.geom.pos[i] = at[i];
        c.geom.normal[i] = normal[i];
    }
    c.geom.depth = depth;
    dJointAttach(dJointCreateContact(run->world, run->contacts, &c), a, b);
}

static void meet_ground(Run *run, int h) {
    const Robot *r = run->robot;
    int b = r->half_body[h], kept = 0;
    const dReal *m = dBodyGetRotation(run->body[b]), *x = dBodyGetPosition(run->body[b]), *c = r->com[b];
    double found[PER_HALF][3], low = x[2] - m[8] * c[0] - m[9] * c[1] - m[10] * c[2];
    if (low > 0.2) return;
    for (int k = 0; k < r->points[h]; k++) {
        const double *q = r->point[h] + 3 * k;
        double z = low + m[8] * q[0] + m[9] * q[1] + m[10] * q[2];
        if (z >= 0) continue;
        int slot = kept < PER_HALF ? kept++ : -1;
        if (slot < 0) {
            slot = 0;
            for (int i = 1; i < PER_HALF; i++)
                if (found[i][2] > found[slot][2]) slot = i;
            if (z >= found[slot][2]) continue;
        }
        for (int i = 0; i < 3; i++)
            found[slot][i] = x[i] + m[4 * i] * (q[0] - c[0]) + m[4 * i + 1] * (q[1] - c[1]) + m[4 * i + 2] * (q[2] - c[2]);
    }
    static const double up[3] = {0, 0, 1};
    for (int k = 0; k < kept; k++) touch(run, found[k], -found[k][2], up, run->body[b], 0);
}

static void meet_itself(Run *run) {
    const Robot *r = run->robot;
    dVector3 a, b;
    const int ends[2] = {1, 5};
    double *at[2] = {a, b};
    for (int e = 0; e < 2; e++)
        dBodyGetRelPointPos(run->body[ends[e]], r->cube[e][0] - r->com[ends[e]][0], r->cube[e][1] - r->com[ends[e]][1], r->cube[e][2] - r->com[ends[e]][2], at[e]);
    double n[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]}, far = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    if (far >= 2 * r->ball || far < 1e-6) return;
    double middle[3];
    for (int i = 0; i < 3; i++) {
        middle[i] = 0.5 * (a[i] + b[i]);
        n[i] /= far;
    }
    touch(run, middle, 2 * r->ball - far, n, run->body[1], run->body[5]);
}

// Spring and play of the connector: torques along the twist between its sides.
static void connector(Run *run) {
    const Robot *r = run->robot;
    if (r->bodies < 8) return;
    const dReal *p = dBodyGetQuaternion(run->body[3]), *q = dBodyGetQuaternion(run->body[7]);
    // conj(p) q
    double w = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3], v[3];
    v[0] = p[0] * q[1] - p[1] * q[0] - p[2] * q[3] + p[3] * q[2];
    v[1] = p[0] * q[2] - p[2] * q[0] - p[3] * q[1] + p[1] * q[3];
    v[2] = p[0] * q[3] - p[3] * q[0] - p[1] * q[2] + p[2] * q[1];
    const dReal *u = dBodyGetAngularVel(run->body[7]), *s = dBodyGetAngularVel(run->body[3]), *m = dBodyGetRotation(run->body[3]);
    double torque[3], half = r->robot[LINK_PLAY];
    for (int k = 0; k < 3; k++) {
        double twist = (w < 0 ? -2 : 2) * v[k], slip = 0;
        for (int i = 0; i < 3; i++) slip += m[4 * i + k] * (u[i] - s[i]);
        double beyond = twist - (twist < -half ? -half : twist > half ? half : twist);
        torque[k] = beyond == 0 ? 0 : -r->robot[LINK_STIFFNESS] * beyond - r->robot[LINK_DAMPING] * slip;
        if (half > 0 && torque[k] * beyond > 0) torque[k] = 0;
    }
    double t[3];
    for (int i = 0; i < 3; i++) t[i] = m[4 * i] * torque[0] + m[4 * i + 1] * torque[1] + m[4 * i + 2] * torque[2];
    dBodyAddTorque(run->body[7], t[0], t[1], t[2]);
    dBodyAddTorque(run->body[3], -t[0], -t[1], -t[2]);
}

static void read_angles(Run *run) {
    for (int k = 0; k < JOINTS; k++) run->angle[k] += remainder(dJointGetHingeAngle(run->hinge[k]) - run->angle[k], 2 * M_PI);
}

static void step(Run *run, const double *disturbance) {
    const Robot *r = run->robot;
    double drawn = 0;
    int loose[JOINTS];
    for (int k = 0; k < JOINTS; k++) {
        const double *p = of(r, k);
        motor_receive(&run->motor[k], p, &r->schedule[k], run->t);
        Order o = motor_order(&run->motor[k], p, run->bus, run->angle[k], dJointGetHingeAngleRate(run->hinge[k]), run->t, r->step);
        loose[k] = o.loose;
        dJointSetHingeParam(run->hinge[k], dParamVel, o.speed);
        dJointSetHingeParam(run->hinge[k], dParamFMax, o.loose ? 0 : o.limit);
        dJointAddHingeTorque(run->hinge[k], o.torque + disturbance[k]);
    }
    connector(run);
    for (int h = 0; h < HALVES; h++) meet_ground(run, h);
    meet_itself(run);
    if (r->quick) dWorldQuickStep(run->world, r->step);
    else dWorldStep(run->world, r->step);
    dJointGroupEmpty(run->contacts);
    read_angles(run);
    for (int k = 0; k < JOINTS; k++) {
        dVector3 axis;
        dJointGetHingeAxis(run->hinge[k], axis);
        const dReal *f = run->feedback[k].t1;
        double torque = loose[k] ? 0 : f[0] * axis[0] + f[1] * axis[1] + f[2] * axis[2];
        motor_follow(&run->motor[k], of(r, k), run->bus, run->angle[k], dJointGetHingeAngleRate(run->hinge[k]), torque, r->step);
        drawn += run->motor[k].duty * run->motor[k].amps;
    }
    run->bus = fmax(r->robot[VOLTS] - r->robot[SAG] * drawn, 0.3 * r->robot[VOLTS]);
    dVector3 v;
    dBodyGetRelPointVel(run->body[3], -r->com[3][0], -r->com[3][1], -r->com[3][2], v);
    const dReal *m = dBodyGetRotation(run->body[3]);
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < 3; i++) run->force[k] += m[4 * i + k] * ((v[i] - run->before[i]) / r->step - r->gravity[i]);
    for (int i = 0; i < 3; i++) run->before[i] = v[i];
    run->forces++;
    run->t += r->step;
}

static void sample(Run *run, double *row) {
    const Robot *r = run->robot;
    double *x = row;
    *x++ = run->t;
    for (int k = 0; k < JOINTS; k++) *x++ = run->motor[k].wire;
    for (int k = 0; k < JOINTS; k++) {
        Motor now = run->motor[k];
        if (!(of(r, k)[STIFFNESS] > 0 || of(r, k)[PLAY] > 0)) now.rotor = run->angle[k];
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
    dVector3 at;
    dBodyGetRelPointPos(run->body[3], -r->com[3][0], -r->com[3][1], -r->com[3][2], at);
    const dReal *q = dBodyGetQuaternion(run->body[3]), *m = dBodyGetRotation(run->body[3]), *w = dBodyGetAngularVel(run->body[3]);
    for (int k = 0; k < 3; k++) *x++ = at[k];
    for (int k = 0; k < 4; k++) *x++ = q[k];
    for (int k = 0; k < 3; k++) *x++ = m[k] * w[0] + m[4 + k] * w[1] + m[8 + k] * w[2];
    for (int k = 0; k < 3; k++)
        *x++ = run->forces ? run->force[k] / run->forces : -(m[k] * r->gravity[0] + m[4 + k] * r->gravity[1] + m[8 + k] * r->gravity[2]);
    for (int k = 0; k < JOINTS; k++) *x++ = run->angle[k];
    memset(run->force, 0, sizeof run->force);
    run->forces = 0;
}

// Goes on in another robot from where this one is. Its frames stand where these do; readings of conventions that differ
// by more than the command are those of the same angles.
static void fork_to(const Run *from, Run *to) {
    const Robot *a = from->robot, *b = to->robot;
    to->bus = from->bus;
    to->t = from->t;
    memset(to->force, 0, sizeof to->force);
    to->forces = 0;
    for (int i = 0; i < b->bodies; i++) {
        int k = i < a->bodies ? i : 3;
        dVector3 at, v;
        dBodyGetRelPointPos(from->body[k], b->com[i][0] - a->com[k][0], b->com[i][1] - a->com[k][1], b->com[i][2] - a->com[k][2], at);
        dBodyGetRelPointVel(from->body[k], b->com[i][0] - a->com[k][0], b->com[i][1] - a->com[k][1], b->com[i][2] - a->com[k][2], v);
        const dReal *w = dBodyGetAngularVel(from->body[k]);
        dBodySetPosition(to->body[i], at[0], at[1], at[2]);
        dBodySetQuaternion(to->body[i], dBodyGetQuaternion(from->body[k]));
        dBodySetLinearVel(to->body[i], v[0], v[1], v[2]);
        dBodySetAngularVel(to->body[i], w[0], w[1], w[2]);
    }
    for (int i = 0; i < 3; i++) to->before[i] = from->before[i];
    for (int k = 0; k < JOINTS; k++) {
        to->angle[k] = from->angle[k];
        to->motor[k] = from->motor[k];
        to->motor[k].sent = 0;
    }
}

// See mujoco_play.c.
int play(const Robot *robot, double settle, double row_s, int rows, const double *disturbance, double *log, const Robot **others, const double **others_disturbance,
         int count, double *other_logs) {
    static int begun;
    if (!begun++) dInitODE();
    Run run = {.robot = robot, .bus = robot->robot[VOLTS], .t = -settle};
    Run *fork = calloc(count > 0 ? count : 1, sizeof *fork);
    build(&run);
    read_angles(&run);
    int bad = 0;
    for (int k = 0; k < JOINTS; k++) motor_start(&run.motor[k], of(robot, k), run.angle[k]);
    for (int c = 0; c < count; c++) {
        fork[c].robot = others[c];
        build(&fork[c]);
    }
    int per_row = (int)lround(row_s / robot->step), per_second = (int)lround(1 / row_s);
    for (long n = 0, before = lround(settle / robot->step); n < before; n++) step(&run, disturbance + JOINTS * (int)(n * robot->step / 0.01));
    run.t = 0;
    memset(run.force, 0, sizeof run.force);
    run.forces = 0;
    for (int row = 0; row < rows && !bad; row++) {
        sample(&run, log + (long)row * ROW);
        if (row % (2 * per_second) == 0)
            for (int c = 0; c < count; c++) {
                fork_to(&run, &fork[c]);
                int steps = (int)lround(row_s / others[c]->step);
                for (int i = row; i < row + per_second && i < rows; i++) {
                    sample(&fork[c], other_logs + ((long)c * rows + i) * ROW);
                    for (int s = 0; s < steps; s++) step(&fork[c], others_disturbance[c] + JOINTS * (int)((settle + fork[c].t) / 0.01));
                }
            }
        for (int i = 0; i < per_row; i++) step(&run, disturbance + JOINTS * (int)((settle + run.t) / 0.01));
        const dReal *x = dBodyGetPosition(run.body[3]);
        for (int k = 0; k < 3; k++) bad |= !isfinite(x[k]) || fabs(x[k]) > 1e2;
        for (int k = 0; k < JOINTS; k++) bad |= !isfinite(run.angle[k]) || fabs(run.angle[k]) > 1e3;
    }
    for (int c = 0; c < count; c++) destroy(&fork[c]);
    destroy(&run);
    free(fork);
    return bad;
}
