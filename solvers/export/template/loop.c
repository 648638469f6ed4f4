/* Plans and ticks in threads of their own, against the clock, as a robot would run them. There is no robot here: the measured state is
 * that of the plan. Prints late ticks, missed plans, the worst tick, and the memory of the process.
 *
 * loop [SECONDS]. On a robot: state from the estimator in place of `measure`, torques to the motors in place of `act`. */
#define _GNU_SOURCE
#include <math.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <time.h>

#include "NAME.h"

static const double TICK = 0.002, PERIOD = @PERIOD@; /* [s] */
enum { MOST = 1 << 20 };

static NAME *controller;
static double seconds = 10.0, beginning;
static double ticks_us[MOST], plans_ms[MOST];
static long num_ticks, num_plans, late_ticks, missed_plans, faults;
static long settled; /* memory after the first 500 ticks [kB] */
static _Atomic int over;

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec - beginning;
}

static void sleep_until(double t)
{
    t += beginning;
    struct timespec at = {(time_t)t, (long)(1e9 * (t - floor(t)))};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL)) continue;
}

/* The measured state: here that of a robot that stands where the motion begins. */
static void measure(double x[NAME_NX])
{
    static const double standing[NAME_NX] = {@INITIAL@};
    memcpy(x, standing, sizeof standing);
}

static void act(const NAME_output *output) { (void)output; }

/* A real-time priority, if the system allows it: ticks go before plans. */
static void set_priority(int value)
{
    struct sched_param own = {.sched_priority = value};
    if (pthread_setschedparam(pthread_self(), SCHED_FIFO, &own) && value > 1) fprintf(stderr, "no real-time priority\n");
}

static void *plan(void *nothing)
{
    (void)nothing;
    double x[NAME_NX];
    set_priority(1);
    for (double due = PERIOD; !over; due += PERIOD) {
        if (now() > due + PERIOD) missed_plans++;
        else sleep_until(due);
        const double t = now();
        measure(x);
        if (NAME_plan(controller, x, t)) faults++;
        if (num_plans < MOST) plans_ms[num_plans++] = 1e3 * (now() - t);
    }
    return NULL;
}

static long resident(void)
{
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    return usage.ru_maxrss;
}

static void tick(void)
{
    double x[NAME_NX];
    NAME_output output;
    set_priority(2);
    for (double due = TICK; due < seconds; due += TICK) {
        sleep_until(due);
        const double t = now();
        late_ticks += t > due + 0.5 * TICK;
        measure(x);
        if (NAME_tick(controller, x, t, &output)) faults++;
        act(&output);
        if (num_ticks == 500) settled = resident();
        if (num_ticks < MOST) ticks_us[num_ticks++] = 1e6 * (now() - t);
    }
}

static int by_size(const void *a, const void *b) { return (*(const double *)a > *(const double *)b) - (*(const double *)a < *(const double *)b); }

static void report(const char *what, double *times, long count)
{
    if (!count) return;
    qsort(times, (size_t)count, sizeof *times, by_size);
    printf("%s: %ld, median %.3g, 99 %% %.3g, worst %.3g\n", what, count, times[count / 2], times[count * 99 / 100], times[count - 1]);
}

int main(int count, char **arguments)
{
    if (count > 1) seconds = atof(arguments[1]);
    const size_t size = NAME_memory_size();
    void *memory = aligned_alloc(64, size);
    if (memory) memset(memory, 0, size); /* all pages are there before the clock starts */
    if (mlockall(MCL_CURRENT | MCL_FUTURE)) fprintf(stderr, "memory is not locked\n");
    if (!(controller = NAME_init(memory, size, NULL))) return 2;
    double x[NAME_NX];
    measure(x);
    const int status = NAME_reset(controller, x, 0.0);
    if (status) return printf("no first plan: %s\n", NAME_status_text(status)), 1;
    pthread_t planner;
    beginning = now();
    if (pthread_create(&planner, NULL, plan, NULL)) return 2;
    tick();
    over = 1;
    pthread_join(planner, NULL);
    report("plans [ms]", plans_ms, num_plans);
    report("ticks [us]", ticks_us, num_ticks);
    printf("%ld of %ld plans missed, %ld of %ld ticks late, %ld faults; memory %ld kB, %ld kB more than after 500 ticks\n", missed_plans,
           num_plans, late_ticks, num_ticks, faults, resident(), settled ? resident() - settled : 0);
    free(memory);
    return faults != 0;
}
