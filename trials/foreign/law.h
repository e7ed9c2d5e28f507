// One motor of the meta-module as reality has it: transport, servo, motor, gear. Written for robots that physics
// engines play; it shares nothing with the simulator, the emulated robot or the diagnosis of this project. The Python
// side reads the enumerations below.
#pragma once

#define JOINTS 6
#define DELAY_MAX 256

// Parameters of one joint. Neutral value: 0 unless stated.
enum joint_key {
    GAIN,             // P of the servo, 1/s
    SPEED_LIMIT,      // rad/s
    TORQUE_LIMIT,     // N m
    DAMPING,          // N m s/rad at the motor's side
    TORQUE_PER_AMP,   // N m/A at the gear's output, also V s/rad
    OHM,              // winding
    CURRENT_LIMIT,    // A, 0 = none
    COULOMB,          // N m
    STATIC,           // what sticking adds to it, N m
    STRIBECK_SPEED,   // rad/s
    STRIBECK_POWER,   // exponent of the Stribeck curve
    BRISTLE,          // angle over which friction builds up, rad
    VISCOUS,          // N m s/rad
    QUADRATIC,        // N m s2/rad2
    LOAD_SHARE,       // friction per N m of load
    ASYMMETRY,        // N m more in + direction, as much less in -
    RIPPLE,           // N m
    RIPPLE_PERIODS,   // per turn
    RIPPLE_PHASE,     // rad
    PLAY,             // half width between motor and link, rad
    STIFFNESS,        // between motor and link, N m/rad, 0 = rigid
    TWIST_DAMPING,    // N m s/rad
    ROTOR,            // inertia of a motor that is loose from its link, kg m2
    DEADBAND,         // half width of the error that counts as none, rad
    FEEDBACK_DELAY,   // s
    LAG,              // s
    DROOP,            // speed lost per torque, rad/s per N m
    HEAT_TIME,        // s, 0 = none
    HEAT_FRACTION,    // share of the torque limit that a hot motor lacks
    HEAT_CURRENT,     // A at which it becomes that hot
    SIGN,             // of set-points, 1 or -1
    SCALE,            // of set-points, 1 = none
    OFFSET,           // rad
    READINGS_TOO,     // whether readings pass the convention backwards
    HOMING,           // rad, of this run
    ECCENTRIC,        // outside: error of the gear in angle, rad
    ECCENTRIC_NM,     // outside: the same wheel's torque, N m
    ECCENTRIC_PERIODS,
    ROUGH,            // outside: friction that depends on the place, N m
    ROUGH_PERIODS,
    DRIFT,            // outside: zero that runs away, rad/s
    TETHER,           // outside: cable, N m/rad
    TETHER_REST,      // rad
    ONE_SIDED,        // outside: gain in + direction over that in -, less 1
    JOINT_KEYS
};

// Parameters of the robot.
enum robot_key {
    VOLTS,            // supply without load, V
    SAG,              // resistance of the battery, ohm
    LINK_STIFFNESS,   // connector between the modules, N m/rad, 0 = welded
    LINK_PLAY,        // its half width, rad
    LINK_DAMPING,     // N m s/rad
    ROBOT_KEYS
};

typedef struct {
    double rotor, rotor_speed;   // motor side where it is loose
    double bristle;              // deflection, rad
    double asked;                // speed asked for, after the lag
    double torque, steady;       // of the motor: now, averaged
    double heat;                 // 0..1
    double amps, duty;
    double seen[DELAY_MAX];      // readings of the last ticks
    int newest, sent;
    double goal, wire;
    double link_nm;              // torque on the link, loose joints
} Motor;

// What the engine is asked for: a speed with a limited torque and a torque beside it, or a torque alone.
typedef struct {
    int loose;
    double speed, limit, torque;
} Order;

typedef struct {
    int count;
    const double *due, *value;   // set-points by the time at which they come into force
} Schedule;

void motor_start(Motor *m, const double *p, double angle);
double motor_encoder(const Motor *m, const double *p, double t);
// Encoder value in the frame of the wire, and back.
double wire_reading(const double *p, double angle);
double wire_speed(const double *p, double speed);
double angle_of_reading(const double *p, double reading);
void motor_receive(Motor *m, const double *p, const Schedule *s, double t);
Order motor_order(Motor *m, const double *p, double bus, double link, double link_speed, double t, double dt);
// Torque that the engine needed where the joint is rigid.
void motor_follow(Motor *m, const double *p, double bus, double link, double link_speed, double torque, double dt);
