/* The interface between the solver, the modes and Python. Sizes are those of the compiled problem; the caller owns all memory. */
#ifndef PIAFFE_H
#define PIAFFE_H
#include <stdatomic.h>
#include <stddef.h>
#include "constants.h"
#include "simd.h"

#define W PIAFFE_W

/* W nodes that are evaluated together, one per SIMD lane. Lanes beyond `count` repeat lane 0, with weights and masks 0. In the
 * arrays of a block, row r of lane l is at [r * W + l]. */
typedef struct {
    int count;
    int phase[W], index[W];                 /* the stage (or phase end, or transition) of each lane */
    double dt[W];                           /* time step; 0 in lanes beyond count */
    double *p;                              /* parameters */
    double *weight, *g_mask, *h_mask;       /* per row; 0 in lanes beyond count */
    double *z, *residual, *g, *h;           /* values at the trial */
    double *z0, *residual0, *g0, *h0;       /* values at the accepted iterate */
    double *factors, *factors0;             /* factors of the implicit part's matrix at the trial and the accepted iterate */
    double *relaxation, *shift, *multiplier, *penalty;
    double *work;                           /* of the functions, (num_work) of the largest mode or transition; all blocks and phases may share it */
} Block;

struct Phase;

/* One mode: its sizes, and functions that are compiled with these sizes as constants. */
typedef struct {
    int nx, ndx, nu, nz, nf, num_finish, num_work, np, nr, ng, nh, mr, mg, mh;
    int num_parts;                          /* parts of the state: */
    const int *part_size, *part_is_rotation; /* size in the tangent; 1 for a quaternion */
    const double *state_sizes;              /* natural sizes of the state's tangent; NULL: all are 1 */
    void (*values)(const Block *b, const double *const *x, const double *const *u, double *const *x_next);
    void (*lq)(const Block *b, const double *const *x, const double *const *u, const double *const *xn,
               const double *slope, const double *curvature, double *const *D, double *const *finish,
               double *const *grad, double *const *H);
    void (*end_values)(const Block *b, const double *const *x);
    void (*end_lq)(const Block *b, const double *const *x, const double *slope, const double *curvature,
                   double *const *grad, double *const *H);
    void (*end_value)(const struct Phase *phase);
    int (*backward)(const struct Phase *phase, double regularization);
    void (*forward)(const struct Phase *phase, const double *defects, const double *next_defects, int feedforward,
                    double *dV);
} Mode;

/* The change of the state between two phases. Its rows (on impulses) are rows of the last node, after the mode's; lq adds their
 * gradient and Hessian to those of the mode. */
typedef struct {
    int nx, ndx, nx_next, ndx_next, nz, nf, num_work, np, nr, ng, nh;
    void (*values)(const Block *b, const double *const *x, double *const *x_next);
    void (*lq)(const Block *b, const double *const *x, const double *const *xn, const double *slope,
               const double *curvature, double *const *P, double *const *grad, double *const *H);
} Transition;

/* One phase of N stages; row-major arrays. */
typedef struct Phase {
    const Mode *mode;
    int N;
    double dt;
    double *x, *u;                          /* accepted: (N+1, nx), (N, nu) */
    double *xt, *ut;                        /* trial */
    double *x_outside, *u_outside;          /* the last trial whose merit was not finite; NULL: nobody reads it */
    double *x_next;                          /* dynamics of the stages at trial and accepted: (N, nx) */
    double *start;                          /* the initial state or the result of the reset, to compare with node 0: (nx) */
    double *d, *dt_trial;                   /* defects, accepted and trial: (N+1, ndx) */
    double *D, *finish;                     /* (N, ndx, nw), (N, num_finish): of a step in parts, see finish.inc */
    double *grad, *H;                       /* (N, nw), (N, nw, nw) upper */
    double *end_grad, *end_H;               /* (ndx), (ndx, ndx) upper */
    double *P;                              /* (ndx of the next, ndx) */
    double *dx, *du;                        /* step */
    double *k, *K;                          /* (N, nu), (N, nu, ndx) */
    double *V_x, *V_first, *V_last;         /* (N+1, ndx); V_xx of nodes 0 and N: (ndx, ndx) */
    double *V_xx;                           /* (N+1, ndx, ndx), with the first and the last; NULL: nobody reads it */
    double *Q_x, *Q_u, *Q_xx, *Q_ux, *Q_uu; /* Q_x and Q_xx may be NULL, and all of Q, if nobody reads them */
    double *work;                           /* of the sweep, see Block */
    const unsigned char *shooting;          /* (N+1): 0 for roll-out nodes, whose states follow from the dynamics; NULL: none */
    int keep;                               /* whether the sweep stores Q and all V_xx */
    struct Phase *next;
} Phase;

typedef struct {
    double max_defect, max_equality, max_inequality, cost_tolerance, barrier_weight, barrier_factor, barrier_gap,
        min_barrier_weight, relaxation, stiffness, max_stiffness, penalty, penalty_factor, max_penalty, armijo, merit_margin,
        merit_offset, step_shrink, min_step, regularization, max_regularization, cost_scale, cost_floor, time_scale, time_limit_s;
    int max_iterations, max_inner, corrections;
    int adapt;                              /* whether a solve changes barrier, multipliers and penalties */
} Options;

typedef struct {
    double iteration, cost, merit, expected, max_defect, max_equality, max_inequality, step_size, regularization,
        barrier_weight, wall_s;
} Record;

/* Groups of blocks: of one mode (stages, ends) or one kind of transition. */
typedef struct {
    const Mode *mode;
    const Transition *transition;
    int num_blocks, num_ends;
    Block *blocks, *ends;
} Group;

enum { CONVERGED, ITERATION_LIMIT, TIME_LIMIT, LINE_SEARCH_FAILED, INFEASIBLE, NOT_FINITE, INTERRUPTED, STATIONARY };

typedef struct Problem {
    int num_phases, num_groups, num_transitions;
    Phase *phases;
    Group *groups;                          /* stages and ends, by mode */
    Group *transitions;                     /* one group per kind of transition */
    const double *initial;
    Options options;
    Record *history;                        /* (max_iterations); NULL: nobody reads it */
    _Atomic int num_records;                /* written after the record, so that a reader sees complete records */
    _Atomic int cancel;                     /* another thread sets it to stop the solve */
    int cleared;                            /* whether the constant zeros of D, H, end_H, P are set; 0 after each new layout */
    double *slope, *curvature;              /* work arrays like those of a block: rows of the largest mode times W */
    /* state of a solve */
    double share;                           /* of the cost in the linear-quadratic model; 1 but for attempts to find a feasible point */
    double weight, rho, least_rho, regularization_now, cost, gap, max_defect, max_equality, max_inequality, last_equality, last_cost, last_violation, last_inequality, stiffness,
        last_step;
    /* of a warm start: the merit at its state of the search; its cost, used if that state is of another problem */
    double resume_merit, resume_cost;
    double began;                           /* when the solve did, on its clock [s] */
    int resume_converged;
    int inner, unmoved, has_last_cost, has_inequalities, num_gains, blocked; /* blocked: whether a trial since the previous iterate was not finite */
    double (*clock)(void *);                /* seconds; 0: that of the system */
    void *clock_data;
    double gains[PATIENCE];                 /* what the last steps of the sub-problem gained, in turn */
} Problem;

/* Before each call the caller writes the start to xt and ut of each phase (a solve swaps these pointers with x and u), relaxations,
 * shifts, multipliers and penalties to all lanes of the blocks, and sets cancel = 0. If resumed: also weight, has_last_cost and
 * last_cost. If resumed is 2: also rho, least_rho, regularization_now, last_step, last_equality, last_violation, last_inequality, stiffness, inner, unmoved,
 * gains, num_gains and the resume_ fields. Everything else may be of any other solve. */
int piaffe_solve(Problem *problem, int resumed);
/* The clock of a problem [s]. */
double piaffe_now(const Problem *problem);
int piaffe_policy(Problem *problem);
/* After a solve that did not adapt; the caller has set last_equality. */
void piaffe_adapt(Problem *problem, int status, double largest_defect);
double piaffe_merit(Problem *problem);
/* Before the call the caller writes the guess to xt and ut; the call overwrites relaxations, shifts, multipliers and penalties. */
double piaffe_predicted(Problem *problem, double unit, double time);
#endif
