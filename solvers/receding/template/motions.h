/* Several motions in one controller, each with a planner of its own. One of them is active: it makes the plans. Another one, which is
 * asked for, takes over at a boundary of the active motion's phases at which contacts allow, or at its end. motions.py fills the
 * memory; numpy_motions.py is the same in Python. */
#ifndef PIAFFE_MOTIONS_H
#define PIAFFE_MOTIONS_H

#include "receding.h"

typedef struct {
    Receding *planner;
    int after;                          /* the motion that follows its end; -1: the last one that had no end */
    const int *entries;                 /* (num_entries + 1, num): at the start of each phase, and at the end, the phase with which
                                           each motion begins there; -1 if it does not */
} Motion;

typedef struct motions {
    const Motion *motions;
    int num, preparations;              /* of plans that are made ahead of a change, at least */
    double period;                      /* between plans [s] */
    const double *wanted;               /* which motion is asked for: num * number of requests + motion; beside the commands */
    Plan ahead;                         /* memory of the plan that is made ahead of a change */
    double seen;                        /* the last request */
    int active, home, request;          /* motion of the plans; the last one without an end; the one that is asked for, or -1 */
    int next, entry, made;              /* motion that is prepared, or -1; its first phase; plans that have been made ahead */
    int left;                           /* the motion before, if its plan still acts, else -1 */
    double until;                       /* the time at which it ends [s] */
} Motions;

/* As receding_plan. */
int motions_plan(void *motions, const double *x, double t, const Plan *plan);
/* Forgets all plans and the request; `first` is active. */
void motions_reset(Motions *m, int first);
#endif
