/* Random states, times, commands and cancellations, absurd ones among them; every output is checked, and statuses are counted.
 * Plans come at random moments, and sometimes not for seconds, as from a thread that stalls; times jump once, or for good.
 * fuzz [TICKS] [threads] [SEED], for `make sanitize` and `make threads`. With threads, plans, ticks, commands and cancellations have
 * one each; time then waits for plans, which are slow under a sanitizer. */
#define _GNU_SOURCE
#include <math.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "NAME.h"

static const double initial[NAME_NX] = {@INITIAL@}, lower[NAME_NU] = {@LOWER@}, upper[NAME_NU] = {@UPPER@};
static const double TICK = 0.002, PERIOD = @PERIOD@; /* [s] */

static NAME *controller;
static long num_ticks = 20000, num_wrong, num_resets;
static long statuses[NAME_BAD_ARGUMENT + 1], plan_statuses[NAME_BAD_ARGUMENT + 1], bits[5]; /* of ticks; of plans; of fallback */
static _Atomic long at_tick, num_plans;
static _Atomic int over;

typedef struct {
    unsigned long long state;
} Random;

static double uniform(Random *r)
{
    r->state = r->state * 6364136223846793005u + 1442695040888963407u;
    return (double)(r->state >> 11) / 9007199254740992.0;
}

/* Near the motion's beginning; sometimes far away; sometimes not a number. */
static void draw_state(Random *r, double x[NAME_NX])
{
    const double kind = uniform(r), size = kind < 0.8 ? 0.02 : kind < 0.95 ? 1.0 : pow(10.0, 300.0 * uniform(r));
    for (int i = 0; i < NAME_NX; i++) x[i] = initial[i] + size * (2.0 * uniform(r) - 1.0);
    if (kind > 0.98) x[(int)(uniform(r) * NAME_NX)] = kind > 0.99 ? NAN : INFINITY;
}

static double draw_time(Random *r, double t)
{
    const double kind = uniform(r);
    if (kind < 0.97) return t;
    return kind < 0.98 ? NAN : kind < 0.985 ? t - uniform(r) : kind < 0.99 ? -INFINITY : 1e300 * (2.0 * uniform(r) - 1.0);
}

static void check(const NAME_output *output)
{
    int right = output->status >= 0 && output->status <= NAME_BAD_ARGUMENT && output->fallback < 32;
    for (int i = 0; i < NAME_NU; i++) {
        right &= output->torque[i] >= lower[i] && output->torque[i] <= upper[i];
        right &= isfinite(output->joint_position[i]) && isfinite(output->joint_velocity[i]);
    }
    num_wrong += !right;
    if (right) statuses[output->status]++;
    for (int i = 0; i < 5; i++) bits[i] += output->fallback >> i & 1;
}

static void tick_once(Random *r, double t)
{
    double x[NAME_NX];
    NAME_output output;
    draw_state(r, x);
    memset(&output, 0xff, sizeof output);
    NAME_tick(controller, x, draw_time(r, t), &output);
    check(&output);
}

static void plan_once(Random *r, double t)
{
    double x[NAME_NX];
    draw_state(r, x);
    plan_statuses[NAME_plan(controller, x, draw_time(r, t))]++;
    num_plans++;
}

static void command_once(Random *r)
{
    NAME_commands commands;
    memset(&commands, 0, sizeof commands);
    commands.set = (unsigned)(uniform(r) * 18.0);
@FUZZ_COMMANDS@    NAME_command(controller, &commands);
}

/* From where the motion begins; sometimes from anywhere, so that there may be no plan. */
static void reset_once(Random *r)
{
    double x[NAME_NX];
    draw_state(r, x);
    NAME_reset(controller, uniform(r) < 0.9 ? initial : x, 0.0);
    num_resets++;
}

static void *plan(void *nothing)
{
    (void)nothing;
    Random r = {2};
    while (!over) plan_once(&r, (double)at_tick * TICK), sched_yield();
    return NULL;
}

static void *command(void *nothing)
{
    (void)nothing;
    Random r = {3};
    while (!over) command_once(&r), sched_yield();
    return NULL;
}

static void *cancel(void *nothing)
{
    (void)nothing;
    while (!over) NAME_cancel(controller), sched_yield();
    return NULL;
}

static void tell(const char *what, const long *counts, int size)
{
    printf("%s:", what);
    for (int i = 0; i < size; i++)
        if (counts[i]) printf(" %ld %s;", counts[i], NAME_status_text(i));
    printf("\n");
}

static void run(Random *r)
{
    const long planned = (long)(PERIOD / TICK + 0.5);
    double jump = 0.0; /* of the clock */
    long stall = 0; /* ticks without a plan */
    for (long k = 0, began = 0; k < num_ticks; k++) {
        const double t = (double)(k - began) * TICK + jump;
        tick_once(r, t);
        if (stall > 0) stall--;
        else if (uniform(r) * (double)(3 * planned) < 1.0) plan_once(r, t);
        if (uniform(r) < 0.001) stall = (long)(150.0 * uniform(r) * (double)planned);
        if (uniform(r) < 0.0005) jump += 4.0 * uniform(r) - 2.0;
        if (uniform(r) < 0.05) command_once(r);
        if (uniform(r) < 0.01) NAME_cancel(controller);
        if (uniform(r) < 0.002) reset_once(r), began = k + 1, jump = 0.0, stall = 0;
    }
}

static int run_in_threads(Random *r)
{
    const long planned = (long)(PERIOD / TICK + 0.5), ahead = 20 * planned;
    void *(*const works[])(void *) = {plan, command, cancel};
    pthread_t others[3];
    for (int i = 0; i < 3; i++)
        if (pthread_create(&others[i], NULL, works[i], NULL)) return 0;
    for (long k = 0; k < num_ticks; k++) {
        if (at_tick < num_plans * planned + ahead) at_tick++;
        tick_once(r, (double)at_tick * TICK);
    }
    over = 1;
    for (int i = 0; i < 3; i++) pthread_join(others[i], NULL);
    return 1;
}

int main(int count, char **arguments)
{
    if (count > 1) num_ticks = atol(arguments[1]);
    const int threads = count > 2 && !strcmp(arguments[2], "threads");
    Random r = {count > 3 ? (unsigned long long)atoll(arguments[3]) : 1};
    NAME_options options = NAME_default_options();
    options.max_age = 50.0 * PERIOD;
    const size_t size = NAME_memory_size();
    void *memory = aligned_alloc(64, size);
    if (!(controller = NAME_init(memory, size, &options))) return 2;
    NAME_reset(controller, initial, 0.0);
    if (threads && !run_in_threads(&r)) return 2;
    if (!threads) run(&r);
    printf("%ld ticks, %ld plans, %ld resets, %ld wrong outputs\n", num_ticks, (long)num_plans, num_resets, num_wrong);
    tell("ticks", statuses, NAME_BAD_ARGUMENT + 1);
    tell("plans", plan_statuses, NAME_BAD_ARGUMENT + 1);
    printf("ticks with a fallback: program failed %ld, damped %ld, late %ld, latched %ld, relaxed %ld\n", bits[0], bits[1], bits[2],
           bits[3], bits[4]);
    free(memory);
    return num_wrong != 0;
}
