/* A plan: phases of stages, with the expansions of the action value. Its memory belongs to who made it, and does not
 * change while it is followed. plan.py describes the arrays, all row by row. */
#ifndef PIAFFE_PLAN_H
#define PIAFFE_PLAN_H

struct plan_phase { /* N stages */
    int mode, stages;
    const double *times; /* (N + 1) [s] */
    const double *x;     /* (N + 1, nx) */
    const double *u;     /* (N, nu) */
    const double *K;     /* (N, nu, ndx) */
    const double *Q_u;   /* (N, nu) */
    const double *Q_ux;  /* (N, nu, ndx) */
    const double *Q_uu;  /* (N, nu, nu) */
    const double *p;     /* (N, np) parameters */
    const double *g_mask, *h_mask; /* (N, ng), (N, nh) */
};

struct plan { /* phases in the order of time, with states of one size and controls of one size */
    int num_phases;
    const struct plan_phase *phases;
    double anchor[3]; /* frame of its states in the world: x, y [m], yaw [rad] */
};
#endif
