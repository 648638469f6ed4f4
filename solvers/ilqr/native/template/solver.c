/* Multi-phase multiple-shooting iLQR: the algorithm of solvers/ilqr/run.py and outer.py, without Python and without allocation.
 * This file is the loop. The files that it includes are compiled with it as one unit, so that the compiler can inline them.
 * constants.h, which is generated from solvers/constants.py, defines the names in capitals. */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <string.h>
#include <time.h>

#include "piaffe.h"
#include "sizes.h"

#include "manifold.inc"
#include "barrier.inc"
#include "trial.inc"
#include "model.inc"
#include "direction.inc"
#include "clock.inc"
#include "hybrid.inc"
#include "search.inc"
#include "outer.inc"
#include "parts.inc"

static int gained_nothing(const Problem *pr, double tolerance)
{
    if (pr->num_gains < PATIENCE) return 0;
    for (int i = 0; i < PATIENCE; i++)
        if (!(pr->gains[i] < tolerance)) return 0;
    return 1;
}

/* Whether the iterate is stationary only because of the regularisation that keeps the merit finite. Overwrites the step. */
static int is_blocked(Problem *pr, double tolerance)
{
    double dV[2];
    if (!backward(pr, pr->options.regularization)) return 0;
    forward(pr, 0, dV);
    return !(fabs(dV[0] + 0.5 * dV[1]) < tolerance);
}

/* Whether a step that hardly regards the cost reduces the violation; if so, the search goes on. Overwrites the step. */
static int can_improve(Problem *pr)
{
    const Options *o = &pr->options;
    const double regularization = pr->regularization_now;
    int improved = 0;
    pr->share = SHARE_OF_COST;
    linearise(pr);
    if (direction(pr, (double[2]){0, 0}))
        for (double size = 1.0; !improved && size >= SHORTEST_ATTEMPT; size *= o->step_shrink) {
            move(pr, 0, size);
            evaluate(pr);
            const Sums s = sums_of_trial(pr);
            improved = fmax(s.max_h / o->max_equality, s.max_g / o->max_inequality) < IMPROVED * pr->last_violation;
        }
    pr->share = 1.0, pr->regularization_now = regularization;
    linearise(pr);
    if (improved) pr->unmoved = 0;
    return improved;
}

/* The status of a solve without a further step: a number is not finite, violations remain that no step reduces, or the line search
 * failed. */
static int failure(Problem *pr, const Sums *at)
{
    const Options *o = &pr->options;
    const double violation = fmax(at->max_h / o->max_equality, at->max_g / o->max_inequality);
    if (pr->blocked || !model_is_finite(pr)) return NOT_FINITE;
    if (!o->adapt || !(violation > 1) || at->max_defect >= NEARLY_CLOSED) return LINE_SEARCH_FAILED;
    pr->last_violation = violation, pr->regularization_now = 0.0;
    return can_improve(pr) ? LINE_SEARCH_FAILED : INFEASIBLE;
}

static void note(Problem *pr, const Sums *at)
{
    pr->cost = at->cost, pr->gap = at->gap;
    pr->max_defect = at->max_defect, pr->max_equality = at->max_h, pr->max_inequality = at->max_g;
}

static void begin_search(Problem *pr)
{
    pr->rho = pr->least_rho = pr->options.merit_offset;
    pr->regularization_now = 0.0;
    pr->last_step = 1.0;
    pr->inner = pr->unmoved = pr->num_gains = 0;
    pr->last_equality = pr->last_violation = pr->last_inequality = INFINITY;
    pr->stiffness = pr->options.stiffness;
}

/* Whether the merit of the accepted iterate is that of the earlier search. */
static int is_same(const Problem *pr, const Sums *at)
{
    return fabs(at->cost + at->penalty + pr->rho * at->gap - pr->resume_merit) <= SAME_MERIT * size_of(pr, pr->resume_merit);
}

/* `resumed`: 0 for a cold start; 1 if barrier and multipliers are those of an earlier solve; 2 if the state of the search is,
 * too. That state is used only if the merit is still resume_merit. */
int piaffe_solve(Problem *pr, int resumed)
{
    const Options *o = &pr->options;
    double dV[2];
    pr->began = piaffe_now(pr);
    pr->share = 1.0;
    if (!resumed) pr->weight = o->barrier_weight, pr->has_last_cost = 0;
    if (resumed < 2) begin_search(pr);
    pr->num_records = pr->blocked = 0;
    pr->has_inequalities = has_inequalities(pr);
    roll_out_start(pr); /* the caller writes the start into the trial arrays */
    evaluate(pr);
    Sums at = sums_of_trial(pr);
    accept(pr);
    note(pr, &at);
    if (!isfinite(at.cost + at.penalty + at.gap)) return NOT_FINITE;
    if (resumed == 2 && !is_same(pr, &at)) {
        begin_search(pr);
        pr->has_last_cost = pr->resume_converged;
        pr->last_cost = pr->resume_cost;
    }
    linearise(pr);
    for (;;) {
        if (atomic_load_explicit(&pr->cancel, memory_order_relaxed)) return INTERRUPTED;
        note(pr, &at);
        if (!direction(pr, dV)) return failure(pr, &at);
        double tolerance = o->cost_tolerance * size_of(pr, at.cost);
        int stationary = (fabs(dV[0] + 0.5 * dV[1]) < tolerance || gained_nothing(pr, tolerance)) && at.max_defect < o->max_defect;
        int met = at.max_h <= o->max_equality && at.max_g <= o->max_inequality;
        if (stationary && pr->blocked && pr->regularization_now > o->regularization) {
            if (is_blocked(pr, tolerance)) return NOT_FINITE;
            if (!direction(pr, dV)) return failure(pr, &at);
        }
        if (stationary && met && gap_is_closed(pr) && is_exact(pr)) return CONVERGED;
        if (stationary && !o->adapt) return STATIONARY;
        if (pr->num_records >= o->max_iterations) return ITERATION_LIMIT;
        int due = pr->inner >= o->max_inner && at.max_defect < NEARLY_CLOSED && (!met || near_gap(pr) > allowed(pr));
        if (stationary || (due && o->adapt)) {
            update(pr, &at, stationary);
            pr->inner = pr->num_gains = 0;
            linearise(pr);
            if (pr->unmoved > MAX_UNMOVED && !can_improve(pr)) return INFEASIBLE;
            if (!direction(pr, dV)) return failure(pr, &at);
        }
        double size = search(pr, dV, &at);
        if (size < 0.0) return TIME_LIMIT;
        adapt(pr, size);
        note(pr, &at);
        if (pr->history)
            pr->history[pr->num_records] = (Record){
                pr->num_records + 1, at.cost, augmented_of_accepted(pr) + pr->rho * at.gap, -(dV[0] + 0.5 * dV[1]),
                at.max_defect, at.max_h, at.max_g, size, pr->regularization_now, pr->weight, piaffe_now(pr) - pr->began,
            };
        atomic_store_explicit(&pr->num_records, pr->num_records + 1, memory_order_release);
        if (pr->regularization_now > o->max_regularization) return failure(pr, &at);
        if (size > 0.0) linearise(pr);
    }
}

/* After a solve that did not adapt: sets the barrier, multipliers and penalties of the next one, as between two sub-problems;
 * between.py. */
void piaffe_adapt(Problem *pr, int status, double largest_defect)
{
    const Options *o = &pr->options;
    const Sums at = {.max_h = pr->max_equality, .max_g = pr->max_inequality};
    if (status != STATIONARY) {
        const int met = at.max_h <= o->max_equality && at.max_g <= o->max_inequality;
        const int moved = (status == ITERATION_LIMIT || status == TIME_LIMIT) && pr->num_records > 0;
        if (!moved || pr->max_defect >= largest_defect || (met && near_gap(pr) <= allowed(pr))) return;
    }
    update(pr, &at, status == STATIONARY);
}

/* The declared cost that the quadratic model at the guess, which the caller has written into the trial arrays, predicts after one
 * full step; NaN if there is none. Equalities and violated inequalities have penalties relative to `unit`, at stages by the natural
 * time; scale.py. */
double piaffe_predicted(Problem *pr, double unit, double time)
{
    const double penalty = SCALE_PENALTY * unit;
    double dV[2];
    pr->share = 1.0;
    evaluate(pr);
    const Sums at = sums_of_trial(pr);
    accept(pr);
    set_penalties(pr, penalty, time);
    linearise(pr);
    if (!backward(pr, SCALE_RIDGE * unit)) return NAN;
    set_penalties(pr, 0.0, time);
    linearise(pr);
    forward(pr, 0, dV);
    return at.cost + dV[0] + 0.5 * dV[1];
}

/* The merit of the accepted iterate, with the barrier and multipliers as they are now. */
double piaffe_merit(Problem *pr) { return augmented_of_accepted(pr) + pr->rho * pr->gap; }

/* The policy and expansions at the accepted iterate, with the least regularisation that succeeds; 0 if none does. */
int piaffe_policy(Problem *pr)
{
    int found = 0;
    linearise(pr);
    for (int i = 0; i < pr->num_phases; i++) pr->phases[i].keep = pr->phases[i].Q_u || pr->phases[i].V_xx;
    double r = 0.0;
    while (!found && r <= pr->options.max_regularization) {
        found = backward(pr, r);
        r = fmax(POLICY_REGULARIZATION_FACTOR * r, pr->options.regularization);
    }
    for (int i = 0; i < pr->num_phases; i++) pr->phases[i].keep = 0; /* the sweeps of a solve do not need all expansions */
    return found;
}
