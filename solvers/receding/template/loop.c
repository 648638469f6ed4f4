/* The loop of plans and ticks, see loop.h. */
#define _GNU_SOURCE
#include "loop.h"

#include "constants.h"
#include <math.h>
#include <string.h>
#include <time.h>

static double processor_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Planner: makes the plan that was asked for, and hands it over. */
static void make_plan(struct loop *l)
{
    const unsigned place = l->plans.back;
    const double began = processor_seconds();
    memcpy(l->commands, l->asked_commands, sizeof(double) * (size_t)l->num_commands);
    int code = l->make(l->planner, l->asked_state, l->asked_at, l->memories[place]);
    if (code == UNUSABLE_PLAN) {
        atomic_fetch_add_explicit(&l->unusable, 1, memory_order_relaxed);
    } else if (code) {
        atomic_store_explicit(&l->failed, code, memory_order_relaxed);
    } else {
        l->measured_at[place] = l->asked_at, l->seconds[place] = processor_seconds() - began;
        l->newest = place;
        hand_over(&l->plans);
    }
    atomic_store_explicit(&l->work, IDLE, memory_order_release);
}

#include "thread.inc"

void loop_init(struct loop *l, int ready, double next)
{
    handover_init(&l->plans);
    atomic_init(&l->work, IDLE);
    atomic_init(&l->failed, 0);
    atomic_init(&l->unusable, 0);
    l->thread = 0, l->newest = PLACES;
    l->now = -INFINITY, l->next = next, l->due = l->within = 0.0;
    l->fault = 0;
    l->ready = ready, l->waits = l->open = l->skipped = 0;
    l->asked = l->missed = l->taken = 0;
}

static int is_busy(struct loop *l) { return atomic_load_explicit(&l->work, memory_order_acquire) != IDLE; }

static void follow_next(struct loop *l)
{
    use_next(&l->plans);
    *l->followed = l->views[l->plans.acting];
    l->waits = 0, l->ready = 1, l->taken++;
}

/* A plan acts from its start on, and not before the latency after its state; one that is complete later acts at once. */
static int may_act(const struct loop *l, double t)
{
    const unsigned place = l->plans.next;
    return t >= fmax(l->views[place]->phases[0].times[0], l->measured_at[place] + l->latency) - SAME_TIME;
}

static void take_fault(struct loop *l)
{
    int code = atomic_exchange_explicit(&l->failed, 0, memory_order_relaxed);
    if (code) l->fault = code;
}

/* Follows what may act; the planner makes one plan at a time, so this ends. A plan that failed is a fault when it should act. */
static void take_plan(struct loop *l, double t)
{
    l->missed += atomic_exchange_explicit(&l->unusable, 0, memory_order_relaxed);
    if (l->open && t >= l->due - SAME_TIME) l->missed += is_busy(l), l->open = 0;
    if (t >= l->due - SAME_TIME) take_fault(l);
    for (;;) {
        if (!l->waits) l->waits = receive(&l->plans);
        if (!l->waits || !may_act(l, t)) return;
        follow_next(l);
    }
}

static void ask(struct loop *l, const double *x, double t)
{
    memcpy(l->asked_state, x, sizeof(double) * (size_t)l->num_state);
    memcpy(l->asked_commands, l->told, sizeof(double) * (size_t)l->num_commands);
    l->asked_at = t;
    atomic_store_explicit(&l->work, ASKED, memory_order_release);
}

/* Makes the plan that was asked for within the tick. */
static void make_within(struct loop *l)
{
    const double began = processor_seconds();
    make_plan(l);
    l->within += processor_seconds() - began;
}

/* Asks for a plan if one is due. If the planner is busy or the state is not finite, a later tick asks. */
static void ask_if_due(struct loop *l, const double *x, double t)
{
    if (t < l->next - SAME_TIME) return;
    int possible = !is_busy(l);
    for (int i = 0; i < l->num_state; i++) possible &= isfinite(x[i]) != 0;
    if (!possible) {
        if (l->skipped && t >= l->next + l->period - SAME_TIME) l->next += l->period, l->skipped = 0;
        if (!l->skipped) l->skipped = 1, l->asked++, l->missed++;
        return;
    }
    if (!l->skipped) l->asked++;
    l->open = !l->skipped, l->skipped = 0, l->due = t + l->latency;
    while (l->next <= t + SAME_TIME) l->next += l->period;
    ask(l, x, t);
    if (l->thread) {
        wake(l->thread);
    } else {
        make_within(l);
        take_plan(l, t);
    }
}

void loop_begin(struct loop *l, const double *x, double t)
{
    if (is_busy(l)) return;
    ask(l, x, t);
    make_within(l);
    take_fault(l);
    if (!receive(&l->plans)) return;
    follow_next(l);
    l->now = t, l->next = t + l->period;
}

void loop_tick(struct loop *l, const double *x, double t, double *control, struct outcome *out)
{
    l->within = 0.0;
    if (!(t >= l->now - SAME_TIME)) { /* or it is NaN */
        l->fault = TIME_GOES_BACK;
    } else {
        l->now = t;
        if (!l->ready) loop_begin(l, x, t);
        take_plan(l, t);
        ask_if_due(l, x, t);
    }
    l->tick(l->low, x, t, control, out);
}
