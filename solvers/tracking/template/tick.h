/* Data of a low level that minimises the action value; vwbc.py is the same in NumPy, native.py fills the memory. */
#ifndef PIAFFE_TICK_H
#define PIAFFE_TICK_H

#include <math.h>

#include "dual.c"
#include "functions.h"

struct phase { /* of the plan, with N stages; arrays are row by row */
    int mode, stages;
    const double *times, *x, *u, *K, *Q_u, *Q_ux, *Q_uu, *p, *g_mask, *h_mask;
    const double *kept;     /* (ndx), 0 for components that do not count */
    const int *measured_at; /* places in p of what is measured */
};

struct low_level {
    int num_phases, gains, num_measured;
    const struct phase *phases;
    const double *kp, *kd;  /* (nu) */
    const double *measured; /* parameters in place of the plan's */
    double damping, gradient;
};

/* What a tick did; status is -1 if no program was made. active: rows of the mode. */
struct outcome {
    int status, iterations, damped, mode, num_active;
    int *active;
};

typedef void (*tick_function)(const struct low_level *, const struct phase *, int, double, const double *, double *,
                              struct outcome *);
#endif
