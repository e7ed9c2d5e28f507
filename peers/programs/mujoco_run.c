// Steps the exported model in MuJoCo with the servo of Table II, or measures its energy drift.
//
//   mujoco_run MODEL.xml DT CONE TRIALS.bin OUT.bin   every trial; poses and joint angles at 20 Hz to OUT.bin; CONE 0 pyramidal, 1 elliptic
//   mujoco_run MODEL.xml DT energy                  limp robot turning in the air without gravity for 10 s
//
// TRIALS.bin: int32 trials, ticks, joints; f64 gain, speed, torque limit per joint; f64 set-points [trial][tick][joint].
// OUT.bin: f64 [trial][tick + 1][3 position, 4 quaternion, joints].
// Standard output: "name value" lines. All other options are MuJoCo's defaults, or what the model sets for its form of the servo.
#include <math.h>
#include <mujoco/mujoco.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define MAX_JOINTS 12

static double cpu_s(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static void energy(mjModel *m, mjData *d) {
    m->opt.gravity[2] = 0;
    m->opt.disableflags |= mjDSBL_CONTACT;
    m->opt.enableflags |= mjENBL_ENERGY;
    for (int t = 0; t < m->ntendon; t++) m->tendon_frictionloss[t] = 0;
    static const double v[12] = {0.3, 0, 0, 1.0, -2.0, 1.5, 2.0, -1.0, 1.5, -2.0, 1.0, 0.5};
    static const double q[6] = {0.3, -0.5, 0.7, -0.2, 0.4, 0.1};
    for (int k = 0; k < 6; k++) d->qvel[k] = v[k];
    for (int k = 0; k < 6; k++) {
        char name[32];
        snprintf(name, sizeof name, "joint%d", k);
        int j = mj_name2id(m, mjOBJ_JOINT, name);
        d->qpos[m->jnt_qposadr[j]] = q[k];
        d->qvel[m->jnt_dofadr[j]] = v[6 + k];
    }
    mj_forward(m, d);
    double start = d->energy[0] + d->energy[1], worst = 0;
    for (int k = 0; k < (int)(10.0 / m->opt.timestep); k++) {
        mj_step(m, d);
        double drift = fabs(d->energy[0] + d->energy[1] - start) / start;
        if (drift > worst) worst = drift;
    }
    printf("energy_drift %.6g\n", worst);
}

int main(int argc, char **argv) {
    if (argc < 4) return 2;
    char error[1000] = "";
    mjModel *m = mj_loadXML(argv[1], NULL, error, sizeof error);
    if (!m) {
        fprintf(stderr, "%s\n", error);
        return 1;
    }
    m->opt.timestep = atof(argv[2]);
    mjData *d = mj_makeData(m);
    if (!strcmp(argv[3], "energy")) {
        energy(m, d);
        return 0;
    }
    if (argc < 6) return 2;
    m->opt.cone = atoi(argv[3]);
    FILE *in = fopen(argv[4], "rb"), *out = fopen(argv[5], "wb");
    int32_t head[3];
    if (!in || !out || fread(head, 4, 3, in) != 3) return 1;
    int trials = head[0], ticks = head[1], nj = head[2];
    double servo[3 * MAX_JOINTS];
    if (fread(servo, 8, 3 * nj, in) != (size_t)(3 * nj)) return 1;
    double *sp = malloc(sizeof(double) * ticks * nj);
    int qa[MAX_JOINTS], va[MAX_JOINTS], wheel[MAX_JOINTS];
    for (int k = 0; k < nj; k++) {
        char name[32];
        snprintf(name, sizeof name, "joint%d", k);
        int j = mj_name2id(m, mjOBJ_JOINT, name);
        qa[k] = m->jnt_qposadr[j];
        va[k] = m->jnt_dofadr[j];
        snprintf(name, sizeof name, "wheel%d", k);
        int w = mj_name2id(m, mjOBJ_JOINT, name);
        wheel[k] = w < 0 ? -1 : m->jnt_dofadr[w];
    }
    double wall = 0, depth_sum = 0, depth_max = 0, squares = 0, h = m->opt.timestep;
    long depth_count = 0, contacts = 0, steps = 0, error_count = 0;
    for (int trial = 0; trial < trials; trial++) {
        if (fread(sp, 8, (size_t)ticks * nj, in) != (size_t)ticks * nj) return 1;
        mj_resetData(m, d);
        int tick = 0;
        double *now = sp, start = cpu_s();
        for (long step = 0;; step++) {
            double t = step * h;
            while (tick <= ticks && t + 1e-6 >= tick / 20.0) {
                double row[7 + MAX_JOINTS];
                memcpy(row, d->qpos, 7 * sizeof(double));
                for (int k = 0; k < nj; k++) row[7 + k] = d->qpos[qa[k]];
                fwrite(row, 8, 7 + nj, out);
                if (tick < ticks) now = sp + (size_t)tick * nj;
                for (int k = 0; k < nj; k++) {
                    double e = now[k] - d->qpos[qa[k]];
                    squares += e * e;
                    error_count++;
                }
                tick++;
            }
            if (tick > ticks) break;
            for (int k = 0; k < nj; k++) {
                double v = servo[3 * k] * (now[k] - d->qpos[qa[k]]), limit = servo[3 * k + 1];
                v = v > limit ? limit : v < -limit ? -limit : v;
                // Flywheels where the export has them, else velocity actuators in joint order.
                if (wheel[k] >= 0) d->qvel[wheel[k]] = v;
                else d->ctrl[k] = v;
            }
            mj_step(m, d);
            steps++;
            contacts += d->ncon;
            for (int c = 0; c < d->ncon; c++) {
                double depth = -d->contact[c].dist;
                if (depth > 0) {
                    depth_sum += depth;
                    depth_count++;
                    if (depth > depth_max) depth_max = depth;
                }
            }
        }
        wall += cpu_s() - start;
    }
    fclose(out);
    printf("cpu_s %.6f\nspeed %.3f\n", wall, trials * ticks / 20.0 / wall);
    printf("depth_mean_mm %.6f\ndepth_worst_mm %.6f\n", 1e3 * depth_sum / (depth_count + (depth_count == 0)), 1e3 * depth_max);
    printf("tracking_rms_rad %.6f\ncontacts_per_step %.3f\n", sqrt(squares / error_count), (double)contacts / steps);
    printf("version %d\nsolver %d\niterations %d\ncone %d\nintegrator %d\n", mj_version(), m->opt.solver, m->opt.iterations, m->opt.cone, m->opt.integrator);
    return 0;
}
