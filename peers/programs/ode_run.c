// Steps the same robot in ODE (dWorldStep or dWorldQuickStep): rigid bodies, hinges with ODE's own motors, contacts made from the points
// of the exported surface that lie below the ground, the deepest eight per half-sphere.
//
//   ode_run ROBOT.txt DT step|quick TRIALS.bin OUT.bin          formats as in mujoco_run.c
//
// ROBOT.txt: cfm erp friction; bodies: count, then per body parent, offset 3, axis 3, joint, mass, com 3, inertia 6;
// halves: count, then per half body, centre 3, points count, points 3 each.
#include <math.h>
#include <ode/ode.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define MAX_BODIES 13
#define MAX_POINTS 8000
#define PER_HALF 8

static int bodies, halves, parent[MAX_BODIES], joint_of[MAX_BODIES], half_body[16], points[16];
static double offset[MAX_BODIES][3], axis[MAX_BODIES][3], mass[MAX_BODIES], com[MAX_BODIES][3], inertia[MAX_BODIES][6];
static double centre[16][3], *point[16], origin[MAX_BODIES][3], cfm, erp, friction;

static double cpu_s(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static void need(int n, int wanted) {
    if (n != wanted) {
        fprintf(stderr, "robot file is cut short\n");
        exit(1);
    }
}

static void numbers(FILE *f, double *to, int n) {
    for (int k = 0; k < n; k++) need(fscanf(f, "%lf", to + k), 1);
}

static void load(const char *name) {
    FILE *f = fopen(name, "r");
    if (!f) exit(1);
    need(fscanf(f, "%lf %lf %lf %d", &cfm, &erp, &friction, &bodies), 4);
    for (int b = 0; b < bodies; b++) {
        need(fscanf(f, "%d", &parent[b]), 1);
        numbers(f, offset[b], 3);
        numbers(f, axis[b], 3);
        need(fscanf(f, "%d", &joint_of[b]), 1);
        numbers(f, &mass[b], 1);
        numbers(f, com[b], 3);
        numbers(f, inertia[b], 6);
        for (int k = 0; k < 3; k++) origin[b][k] = offset[b][k] + (b ? origin[parent[b]][k] : 0);
    }
    need(fscanf(f, "%d", &halves), 1);
    for (int h = 0; h < halves; h++) {
        need(fscanf(f, "%d", &half_body[h]), 1);
        numbers(f, centre[h], 3);
        need(fscanf(f, "%d", &points[h]), 1);
        point[h] = malloc(sizeof(double) * 3 * points[h]);
        numbers(f, point[h], 3 * points[h]);
    }
    fclose(f);
}

static double depth_sum, depth_max;
static long depth_count;

// Contact joints of one half-sphere.
static void collide(dWorldID world, dJointGroupID group, dBodyID body, int h) {
    int b = half_body[h], kept = 0;
    double found[PER_HALF][4];
    dVector3 at;
    dBodyGetRelPointPos(body, centre[h][0] - com[b][0], centre[h][1] - com[b][1], centre[h][2] - com[b][2], at);
    if (at[2] > 0.07) return;
    for (int k = 0; k < points[h]; k++) {
        const double *q = point[h] + 3 * k;
        dVector3 w;
        dBodyGetRelPointPos(body, centre[h][0] + q[0] - com[b][0], centre[h][1] + q[1] - com[b][1], centre[h][2] + q[2] - com[b][2], w);
        if (w[2] >= 0) continue;
        int slot = kept < PER_HALF ? kept++ : -1;
        if (slot < 0) {
            slot = 0;
            for (int i = 1; i < PER_HALF; i++)
                if (found[i][2] > found[slot][2]) slot = i;
            if (w[2] >= found[slot][2]) continue;
        }
        for (int i = 0; i < 3; i++) found[slot][i] = w[i];
    }
    for (int k = 0; k < kept; k++) {
        dContact c;
        memset(&c, 0, sizeof c);
        c.surface.mode = dContactApprox1;
        c.surface.mu = friction;
        c.geom.depth = -found[k][2];
        for (int i = 0; i < 3; i++) c.geom.pos[i] = found[k][i];
        c.geom.normal[2] = 1;
        dJointAttach(dJointCreateContact(world, group, &c), body, 0);
        depth_sum += c.geom.depth;
        depth_count++;
        if (c.geom.depth > depth_max) depth_max = c.geom.depth;
    }
}

int main(int argc, char **argv) {
    if (argc < 6) return 2;
    load(argv[1]);
    double h = atof(argv[2]);
    int quick = !strcmp(argv[3], "quick");
    FILE *in = fopen(argv[4], "rb"), *out = fopen(argv[5], "wb");
    int32_t head[3];
    if (!in || !out || fread(head, 4, 3, in) != 3) return 1;
    int trials = head[0], ticks = head[1], nj = head[2];
    double servo[3 * MAX_BODIES];
    if (fread(servo, 8, 3 * nj, in) != (size_t)(3 * nj)) return 1;
    double *sp = malloc(sizeof(double) * ticks * nj), wall = 0, squares = 0;
    long error_count = 0;
    dInitODE();
    for (int trial = 0; trial < trials; trial++) {
        if (fread(sp, 8, (size_t)ticks * nj, in) != (size_t)ticks * nj) return 1;
        dWorldID world = dWorldCreate();
        dJointGroupID group = dJointGroupCreate(0);
        dWorldSetGravity(world, 0, 0, -9.80665);
        dWorldSetCFM(world, cfm);
        dWorldSetERP(world, erp);
        dBodyID body[MAX_BODIES];
        dJointID hinge[MAX_BODIES];
        for (int b = 0; b < bodies; b++) {
            body[b] = dBodyCreate(world);
            dMass m;
            double *i = inertia[b];
            dMassSetParameters(&m, mass[b], 0, 0, 0, i[0], i[1], i[2], i[3], i[4], i[5]);
            dBodySetMass(body[b], &m);
            dBodySetPosition(body[b], origin[b][0] + com[b][0], origin[b][1] + com[b][1], 0.055 + origin[b][2] + com[b][2]);
            if (b) {
                hinge[joint_of[b]] = dJointCreateHinge(world, 0);
                dJointAttach(hinge[joint_of[b]], body[b], body[parent[b]]);
                dJointSetHingeAnchor(hinge[joint_of[b]], origin[b][0], origin[b][1], 0.055 + origin[b][2]);
                dJointSetHingeAxis(hinge[joint_of[b]], axis[b][0], axis[b][1], axis[b][2]);
            }
        }
        // ODE reports hinge angles within a half turn; the servo needs them whole.
        double angle[MAX_BODIES] = {0};
        int tick = 0;
        double *now = sp, start = cpu_s();
        for (long step = 0;; step++) {
            double t = step * h;
            for (int k = 0; k < nj; k++) {
                double a = dJointGetHingeAngle(hinge[k]);
                angle[k] += remainder(a - angle[k], 2 * M_PI);
            }
            while (tick <= ticks && t + 1e-6 >= tick / 20.0) {
                double row[7 + MAX_BODIES];
                dVector3 p;
                dBodyGetRelPointPos(body[0], -com[0][0], -com[0][1], -com[0][2], p);
                const dReal *q = dBodyGetQuaternion(body[0]);
                for (int k = 0; k < 3; k++) row[k] = p[k];
                for (int k = 0; k < 4; k++) row[3 + k] = q[k];
                for (int k = 0; k < nj; k++) row[7 + k] = angle[k];
                fwrite(row, 8, 7 + nj, out);
                if (tick < ticks) now = sp + (size_t)tick * nj;
                for (int k = 0; k < nj; k++) {
                    squares += (now[k] - angle[k]) * (now[k] - angle[k]);
                    error_count++;
                }
                tick++;
            }
            if (tick > ticks) break;
            for (int k = 0; k < nj; k++) {
                double v = servo[3 * k] * (now[k] - angle[k]), limit = servo[3 * k + 1];
                dJointSetHingeParam(hinge[k], dParamVel, v > limit ? limit : v < -limit ? -limit : v);
                dJointSetHingeParam(hinge[k], dParamFMax, servo[3 * k + 2]);
            }
            for (int k = 0; k < halves; k++) collide(world, group, body[half_body[k]], k);
            if (quick) dWorldQuickStep(world, h);
            else dWorldStep(world, h);
            dJointGroupEmpty(group);
        }
        wall += cpu_s() - start;
        dJointGroupDestroy(group);
        dWorldDestroy(world);
    }
    fclose(out);
    printf("cpu_s %.6f\nspeed %.3f\n", wall, trials * ticks / 20.0 / wall);
    printf("depth_mean_mm %.6f\ndepth_worst_mm %.6f\n", 1e3 * depth_sum / (depth_count + (depth_count == 0)), 1e3 * depth_max);
    printf("tracking_rms_rad %.6f\n", sqrt(squares / error_count));
    return 0;
}
