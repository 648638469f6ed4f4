/* Random states, times, commands and cancellations, absurd ones among them; every output is checked. fuzz [TICKS] [threads].
 * For `make sanitize` and `make threads`. */
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
static long num_ticks = 20000, num_wrong;
static _Atomic long at_tick;
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
}

static void tick_once(Random *r, long k)
{
    double x[NAME_NX];
    NAME_output output;
    draw_state(r, x);
    memset(&output, 0xff, sizeof output);
    NAME_tick(controller, x, draw_time(r, (double)k * TICK), &output);
    check(&output);
}

static void plan_once(Random *r, double t)
{
    double x[NAME_NX];
    draw_state(r, x);
    NAME_plan(controller, x, draw_time(r, t));
}

static void command_once(Random *r)
{
    NAME_commands commands;
    memset(&commands, 0, sizeof commands);
    commands.set = (unsigned)(uniform(r) * 18.0);
@FUZZ_COMMANDS@    NAME_command(controller, &commands);
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

int main(int count, char **arguments)
{
    if (count > 1) num_ticks = atol(arguments[1]);
    const int threads = count > 2;
    Random r = {1};
    pthread_t others[3];
    NAME_options options = NAME_default_options();
    options.max_age = 1.0;
    const size_t size = NAME_memory_size();
    void *memory = aligned_alloc(64, size);
    if (!(controller = NAME_init(memory, size, &options))) return 2;
    NAME_reset(controller, initial, 0.0);
    if (threads && (pthread_create(&others[0], NULL, plan, NULL) || pthread_create(&others[1], NULL, command, NULL) ||
                    pthread_create(&others[2], NULL, cancel, NULL))) return 2;
    long resets = 0;
    const long planned = (long)(PERIOD / TICK + 0.5);
    for (long k = 0, began = 0; k < num_ticks; k++) {
        at_tick = k - began;
        tick_once(&r, k - began);
        if (threads) continue;
        if (k % planned == 0) plan_once(&r, (double)(k - began) * TICK);
        if (uniform(&r) < 0.05) command_once(&r);
        if (k - began > 2000 || uniform(&r) < 0.001) NAME_reset(controller, initial, 0.0), began = k, resets++;
    }
    over = 1;
    for (int i = 0; threads && i < 3; i++) pthread_join(others[i], NULL);
    printf("%ld ticks, %ld resets, %ld wrong outputs\n", num_ticks, resets, num_wrong);
    free(memory);
    return num_wrong != 0;
}
