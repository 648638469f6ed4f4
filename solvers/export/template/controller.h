/* NAME: a receding horizon and its low level for the robot @ROBOT@: measured state and time in, torques out.
 * Made by Piaffe; see README.md.
 *
 * A state, in SI units: positions and linear velocities in the world, quaternions (w, x, y, z), angular velocities in the frame of
 * the body. Zeros and signs of the joints are those of the robot's model.
@STATE_WORDS@
 *
 * Three threads may use a controller at the same time, one each: `plan`, `tick` and `command`. `cancel` may be called from any
 * thread. No function allocates memory, takes a lock, or waits for another thread. */
#ifndef NAME_H
#define NAME_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

@CONSTANTS@
#define NAME_PERIOD @PERIOD@  /* time between plans [s] */
#define NAME_LATENCY @LATENCY@ /* from a state to the first effect of its plan [s] */

typedef struct NAME NAME;

typedef struct {
    double max_age;               /* a plan acts until its state is this old [s]; more than @DUE_WORDS@ */
    double damping;               /* of the joints, if there is no torque of a plan [Nm s/rad] */
    int iterations;               /* most iterations of a plan, 1 to NAME_MOST_ITERATIONS; the first one has more */
    double time_limit;            /* a plan begins no trial step after this time [s]; 0: no limit */
    double (*clock)(void *data);  /* seconds, for the time limit; NULL: the clock of the system */
    void *clock_data;
} NAME_options;

/* What the functions return, and what NAME_output.status tells. */
enum {
    NAME_OK,
    NAME_NO_PLAN,        /* no plan has been made, or none begins yet */
    NAME_PLAN_TOO_OLD,   /* the plan is older than max_age; until reset */
    NAME_BAD_STATE,      /* a measured number is not finite */
    NAME_BAD_TIME,       /* the time is not finite, goes back, or jumps ahead by more than max_age for the first time */
    NAME_BAD_NUMBERS,    /* numbers of a plan or of a tick are not finite */
    NAME_OUTSIDE,        /* a plan would begin before or after the motion */
    NAME_BAD_COMMAND,    /* a command is not finite or unknown */
    NAME_BAD_ARGUMENT    /* a pointer is null */
};

/* What a tick did in place of the best torques: bits of NAME_output.fallback. */
enum {
    NAME_PROGRAM_FAILED = 1, /* the quadratic program has no solution, or reached its limit: the plan's torques and feedback, clipped */
    NAME_DAMPED = 2,         /* the joints are damped */
    NAME_LATE = 4,           /* the plan is older than a period and the latency: the newer one is late or failed */
    NAME_LATCHED = 8,        /* until reset */
    NAME_RELAXED = 16        /* no torques keep all limits: those on contact forces gave way */
};

@TORQUE_WORDS@typedef struct {
    double torque[NAME_NU];         /* [Nm] */
    double joint_position[NAME_NU]; /* of the plan at this time [rad]; the measured ones if the joints are damped */
    double joint_velocity[NAME_NU]; /* of the plan at this time [rad/s]; 0 if the joints are damped */
@RECORDED@
    double plan_age;        /* time since the state of the plan was measured [s]; negative if there is no plan */
    int status;
    unsigned fallback;
    int plan_status;        /* why the solve of the plan ended, see NAME_plan_status_text */
    int plan_iterations;
    int iterations;         /* of the quadratic program */
@MOTION_OUTPUT@} NAME_output;

@DECLARED_WORDS@@COMMAND@

/* Bytes of a controller. */
size_t NAME_memory_size(void);
/* The values that a controller has without options. */
NAME_options NAME_default_options(void);
/* Makes a controller in memory that is aligned to 64 bytes. NULL if there is too little, or options are out of range. */
NAME *NAME_init(void *memory, size_t size, const NAME_options *options);
/* Forgets plans, commands and faults, and makes the first plan, from a state that is measured at time t since the motion's start [s].
 * It takes longer than others. The other threads stand still. The motion's time goes on when it returns. */
int NAME_reset(NAME *controller, const double x[NAME_NX], double t);
@CONTACTS@/* Sets commands from the next plan on. One thread. */
int NAME_command(NAME *controller, const NAME_commands *commands);
/* Makes a plan from a measured state. One thread. */
int NAME_plan(NAME *controller, const double x[NAME_NX], double t);
/* The torques of a measured state. One thread; it never waits. All of `output` is written, whatever is returned. */
int NAME_tick(NAME *controller, const double x[NAME_NX], double t, NAME_output *output);
/* Ends the plan that is being made: it becomes what it is until then. Any thread. */
void NAME_cancel(NAME *controller);
/* Words for what the functions return. */
const char *NAME_status_text(int status);
const char *NAME_plan_status_text(int status);
@MOTION_DECLARED@
#ifdef __cplusplus
}
#endif
#endif
