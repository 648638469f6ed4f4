/* A controller: plans and ticks, and what they do if something is wrong. */
#include "private.h"

#include <math.h>
#include <string.h>

#include "constants.h"
#include "tick/functions.h"

enum { RELAXED = @RELAXED@ }; /* of the quadratic program */
static const double PERIOD = @PERIOD@, LATENCY = @LATENCY@; /* [s] */
static const double lower[NAME_NU] = {@LOWER@}, upper[NAME_NU] = {@UPPER@}; /* of the torques [Nm] */
static const double declared[NUM_COMMANDS + 1] = {@DECLARED@};

static size_t whole(size_t bytes) { return (bytes + 63) / 64 * 64; }

size_t NAME_memory_size(void) { return whole(sizeof(NAME)) + whole(piaffe_arena_bytes()); }

NAME_options NAME_default_options(void)
{
    return (NAME_options){.max_age = @MAX_AGE@, .damping = @DAMPING@, .iterations = @ITERATIONS@, .time_limit = @TIME_LIMIT@};
}

@PLANNER_CODE@
void NAME_forget(NAME *c)
{
    handover_init(&c->plans);
    handover_init(&c->commands);
    for (int i = 0; i < PLACES; i++) memcpy(c->told[i], declared, sizeof declared);
    memcpy(c->wanted, declared, sizeof declared);
    memcpy(c->memory.commands, declared, sizeof(double) * NUM_COMMANDS);
    c->planned = c->ticked = (struct times){-INFINITY, INFINITY};
    c->ready = c->waits = c->latched = 0;
    c->memory.low.plan = 0;
    forget_plans(c);
}

/* Lets a plan refer to its memory. */
static void place_plan(struct place *p) { p->plan = (Plan){p->header, p->numbers, p->phases, &p->view}; }

NAME *NAME_init(void *memory, size_t size, const NAME_options *options)
{
    const NAME_options own = options ? *options : NAME_default_options();
    if (!memory || (size_t)memory % 64 || size < NAME_memory_size()) return NULL;
    if (!(own.max_age > @DUE@) || !(own.damping >= 0.0 && own.damping < INFINITY)) return NULL;
    if (!(own.time_limit >= 0.0 && own.time_limit < INFINITY) || own.iterations < 1 || own.iterations > NAME_MOST_ITERATIONS) return NULL;
    NAME *c = memory;
    memset(c, 0, sizeof *c);
    piaffe_fill(&c->memory);
    c->memory.low.damping = own.damping;
    for (int i = 0; i < NUM_MOTIONS; i++) {
        Receding *r = NAME_planner(c, i);
        r->arena.base = (unsigned char *)memory + whole(sizeof(NAME));
        r->iterations = own.iterations, r->options.time_limit_s = own.time_limit;
        r->problem->clock = own.clock, r->problem->clock_data = own.clock_data;
    }
    c->options = own;
    for (int i = 0; i < PLACES; i++) place_plan(&c->places[i]);
@AHEAD_CODE@    NAME_forget(c);
    return c;
}

/* Whether to believe a time. One that is far ahead of the last one may be an error of one call: it counts if the next call agrees. */
static int believe(struct times *times, double t, double far)
{
    const int agrees = t >= times->doubted - SAME_TIME && t <= times->doubted + far;
    const int right = times->last == -INFINITY || t <= times->last + far || agrees;
    times->doubted = right ? INFINITY : t;
    if (right && t > times->last) times->last = t;
    return right;
}

int NAME_reset(NAME *c, const double x[NAME_NX], double t)
{
    if (!c || !x) return NAME_BAD_ARGUMENT;
    NAME_forget(c);
    const int status = NAME_plan(c, x, t);
    if (!status) c->ticked.last = t;
    return status;
}

@COMMAND_CODE@

@CONTACTS_CODE@
int NAME_plan(NAME *c, const double x[NAME_NX], double t)
{
    if (!c || !x) return NAME_BAD_ARGUMENT;
    if (!isfinite(t) || t < c->planned.last - SAME_TIME) return NAME_BAD_TIME;
    struct times planned = c->planned;
    if (!believe(&planned, t, c->options.max_age)) return c->planned.doubted = t, NAME_BAD_TIME;
    if (receive(&c->commands)) use_next(&c->commands);
    memcpy(c->memory.commands, c->told[c->commands.acting], sizeof(double) * NUM_COMMANDS);
    switch (NAME_make(c, x, t, &c->places[c->plans.back].plan)) {
    case PLANNED:
        c->planned = planned;
        hand_over(&c->plans);
        return NAME_OK;
    case NOT_FINITE_STATE: return NAME_BAD_STATE;
    case OUTSIDE: return NAME_OUTSIDE;
    default: return NAME_BAD_NUMBERS;
    }
}

void NAME_cancel(NAME *c)
{
    for (int i = 0; c && i < NUM_MOTIONS; i++) NAME_planner(c, i)->problem->cancel = 1;
}

/* A plan acts from its start on; one that is complete later acts at once. */
static void take_plan(NAME *c, double t)
{
    for (int i = 0; i < PLACES; i++) {
        if (!c->waits) c->waits = receive(&c->plans);
        if (!c->waits || c->places[c->plans.next].numbers[c->places[c->plans.next].header[HEADER + AT_TIMES]] > t + SAME_TIME) return;
        use_next(&c->plans);
        c->memory.low.plan = &c->places[c->plans.acting].view;
        c->waits = 0, c->ready = 1;
    }
}

static void damp(const NAME *c, const double *x, NAME_output *out)
{
    out->fallback |= NAME_DAMPED;
    for (int i = 0; i < NAME_NU; i++) {
        const double torque = -c->options.damping * x[NAME_JOINT_VELOCITY + i], angle = x[NAME_JOINT_POSITION + i];
        out->torque[i] = isfinite(torque) ? fmin(fmax(torque, lower[i]), upper[i]) : 0.0;
        out->joint_position[i] = isfinite(angle) ? angle : 0.0;
    }
}

/* What the plan has at this time, and what the model records of the torques. */
static void tell(const NAME *c, NAME_output *out)
{
    const struct outcome *did = &c->memory.outcome;
    memcpy(out->joint_position, did->nominal + NAME_JOINT_POSITION, sizeof out->joint_position);
    memcpy(out->joint_velocity, did->nominal + NAME_JOINT_VELOCITY, sizeof out->joint_velocity);
@RECORDED_CODE@}

int NAME_tick(NAME *c, const double x[NAME_NX], double t, NAME_output *out)
{
    if (!out) return NAME_BAD_ARGUMENT;
    memset(out, 0, sizeof *out);
    out->plan_age = -1.0;
@NO_MOTION@    if (!c || !x) return out->fallback = NAME_DAMPED, out->status = NAME_BAD_ARGUMENT;
    if (!isfinite(t) || t < c->ticked.last - c->options.max_age || !believe(&c->ticked, t, c->options.max_age))
        return damp(c, x, out), out->status = NAME_BAD_TIME;
    if (t < c->ticked.last - SAME_TIME) out->status = NAME_BAD_TIME;
    else take_plan(c, t);
    if (!c->ready) return damp(c, x, out), out->status = out->status ? out->status : NAME_NO_PLAN;
    const struct place *p = &c->places[c->plans.acting];
    out->plan_age = t - p->numbers[MEASURED_AT];
    out->plan_status = (int)p->header[STATUS], out->plan_iterations = (int)p->header[ITERATIONS];
@MOTION_CODE@    if (out->plan_age > PERIOD + LATENCY + SAME_TIME && !c->waits) out->fallback |= NAME_LATE;
    if (out->plan_age > c->options.max_age) c->latched = 1;
    if (c->latched) {
        out->fallback |= NAME_LATCHED;
        return damp(c, x, out), out->status = NAME_PLAN_TOO_OLD;
    }
    for (int i = 0; i < NAME_NX; i++)
        if (!isfinite(x[i])) out->status = NAME_BAD_STATE;
    struct outcome *did = &c->memory.outcome;
    piaffe_tick(&c->memory.low, x, t, out->torque, did);
    out->iterations = did->iterations;
    int finite = !did->damped;
    for (int i = 0; i < NAME_NU; i++) finite &= isfinite(out->torque[i]) != 0;
    if (!finite) {
        if (!out->status) out->status = NAME_BAD_NUMBERS;
        return damp(c, x, out), out->status;
    }
    if (did->status == RELAXED) out->fallback |= NAME_RELAXED;
    else if (did->status > 0) out->fallback |= NAME_PROGRAM_FAILED;
    for (int i = 0; i < NAME_NU; i++) out->torque[i] = fmin(fmax(out->torque[i], lower[i]), upper[i]);
    return tell(c, out), out->status;
}

const char *NAME_status_text(int status)
{
    static const char *const texts[] = {
        "ok", "there is no plan yet", "the plan is too old; reset the controller", "a measured number is not finite",
        "the time is not finite, goes back, or jumps ahead", "numbers of the plan or of the tick are not finite",
        "the plan would begin before or after the motion", "a command is not finite or unknown", "a pointer is null",
    };
    return status >= 0 && status < (int)(sizeof texts / sizeof *texts) ? texts[status] : "unknown";
}

const char *NAME_plan_status_text(int status)
{
    static const char *const texts[] = {
        "converged", "iteration limit", "time limit", "no step helps", "infeasible", "not finite", "cancelled", "no step helps much",
    };
    return status >= 0 && status < (int)(sizeof texts / sizeof *texts) ? texts[status] : "unknown";
}
@MOTION_NAMES@