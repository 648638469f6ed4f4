/* A receding horizon and a low level as one controller: measured state and time in, control out. Plans are made in a thread of their
 * own, or within the tick. loop_memory.py fills the structure. Nothing is allocated but the thread. */
#ifndef PIAFFE_LOOP_H
#define PIAFFE_LOOP_H

#include "handover.h"
#include "plan.h"

struct planned; /* of receding.h */
struct low_level; /* of tick.h */
struct outcome;
struct plan_thread;

enum { IDLE, ASKED };

/* Why there is no plan, beside the codes of receding_plan, of which one is no fault; why there is no thread. */
enum { UNUSABLE_PLAN = 3, TIME_GOES_BACK = 16, NO_THREADS = 32, THREAD_FAILED };

struct loop {
    int (*make)(void *, const double *, double, const struct planned *); /* receding_plan or motions_plan */
    void (*tick)(const struct low_level *, const double *, double, double *, struct outcome *);
    void *planner;
    struct low_level *low;
    const struct plan **followed;         /* the low level's plan */
    const struct planned *memories[PLACES];
    const struct plan *views[PLACES];
    double period, latency;               /* [s], the latency at most the period and at least that of the planner */
    int num_state, num_commands;
    double *commands;                     /* of the planner */
    double *told;                         /* the same as the caller wants them from the next plan on */
    double *asked_state, *asked_commands; /* what the next plan is made of; of the planner while work is ASKED, else of the tick */
    double asked_at;
    double measured_at[PLACES], seconds[PLACES]; /* of each plan: time of its state, time of the processor [s] */
    struct handover plans;
    _Atomic int work, failed, unusable;   /* failed: why there is no plan; unusable: plans that were not finite, not counted yet */
    struct plan_thread *thread;           /* 0: plans are made within the tick */
    unsigned newest;                      /* of the planner: the last place that it handed over, PLACES before the first */
    /* of the tick */
    double now, next, due;                /* last tick; when a plan is asked for; when the one that was asked for should act */
    double within;                        /* time of the processor for plans within the last tick [s] */
    int fault;                            /* what went wrong since the caller looked */
    int ready, waits, open, skipped;      /* there was a plan; one waits for its start; its due time is ahead; none was asked for */
    long asked, missed, taken;            /* plans that were due to be asked for; late or not made; acting since the start */
};

void loop_init(struct loop *l, int ready, double next);
/* Makes a plan now, in this thread, and follows it. */
void loop_begin(struct loop *l, const double *x, double t);
/* The control of a measured state, as a low level's tick: it takes the newest plan that may act, and asks for another if one is due. */
void loop_tick(struct loop *l, const double *x, double t, double *control, struct outcome *out);
/* Start the thread, 0 or why there is none; end it, and wait for the plan that it makes. */
int loop_start(struct loop *l);
void loop_stop(struct loop *l);
#endif
