/* What a controller is made of. */
#ifndef PIAFFE_PRIVATE_H
#define PIAFFE_PRIVATE_H

#include "NAME.h"
#include "handover.h"
#include "memory.h"

enum { NUM_ENTRIES = @NUM_ENTRIES@, NUM_NUMBERS = @NUM_NUMBERS@, NUM_PHASES = @NUM_PHASES@, NUM_COMMANDS = @NUM_COMMANDS@ };

enum { NUM_MOTIONS = @NUM_MOTIONS@ };

/* Memory of a plan. */
struct place {
    _Alignas(64) double numbers[NUM_NUMBERS];
    long header[NUM_ENTRIES];
    struct plan_phase phases[NUM_PHASES];
    struct plan view;
    Plan plan;
};

/* The times of one thread. */
struct times {
    double last, doubted; /* the last one that was believed; one far ahead of it, or INFINITY */
};

struct NAME {
    struct memory memory;
    struct place places[PLACES];
@AHEAD@    NAME_options options;
    struct handover plans;
    /* commands */
    struct handover commands;
    double told[PLACES][NUM_COMMANDS + 1];
    double wanted[NUM_COMMANDS + 1]; /* of the command thread */
    /* of the plan thread */
    struct times planned;
    /* of the tick thread */
    struct times ticked;
    int ready, waits, latched; /* a plan acts; one waits for its start */
};

/* Forgets plans, commands and faults. */
void NAME_forget(NAME *c);
/* The planner of a motion; a plan of the motion that is active. */
Receding *NAME_planner(NAME *c, int motion);
int NAME_make(NAME *c, const double *x, double t, const Plan *plan);
void piaffe_tick(const struct low_level *low, const double *x, double t, double *control, struct outcome *out);
#endif
