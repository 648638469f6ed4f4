/* A tick of the receding horizon: the state is predicted, the motion anchored, the numbers filled, the last plan shifted, and the
 * problem solved. numpy_tick.py is the same in NumPy. Nothing is allocated. */
#include <math.h>
#include <string.h>

#include "motions.h"
#include "sizes.h"

#include "manifold.inc"
#include "calendar.inc"
#include "course.inc"
#include "layout.inc"
#include "numbers.inc"
#include "shift.inc"
#include "rows.inc"
#include "predict.inc"
#include "clock.inc"

/* Writes the header of a plan; returns how many numbers it needs. */
static long lay_plan(const Receding *r, int count, long *header)
{
    const Horizon *h = r->horizon;
    long at = NUM_FIGURES;
    for (int i = 0; i < count; i++) {
        const Span *span = &r->spans[i];
        const int mode = mode_of(h, span), *link = i + 1 < count ? link_of(h, r->spans, i, nodes_of(r, i) + span->stages) : NULL;
        const Mode *m = h->mode_tables[mode];
        const Transition *after = link && link[0] >= 0 ? h->transition_tables[link[0]] : NULL;
        const long N = span->stages, nu = m->nu, ndx = m->ndx, kept = r->adapt_below > 0, read = is_read(h, mode) ? N : 0;
        const long end_g = m->mg + (after ? after->ng : 0), end_h = m->mh + (after ? after->nh : 0);
        const long sizes[] = {N + 1, (N + 1) * m->nx, N * nu, N * nu, N * nu * ndx, h->lean ? 0 : N * ndx, read * nu,
                              h->lean ? 0 : N * ndx * ndx, read * nu * ndx,
                              read * nu * nu, read * m->np, read * m->ng, read * m->nh,
                              after ? after->np : 0, kept * N * m->ng, kept * N * m->ng, kept * N * m->nh, kept * N * m->nh,
                              kept * end_g, kept * end_g, kept * end_h, kept * end_h};
        long part[PART] = {span->segment, span->place.number, span->place.entry, mode, N, span->first, link ? link[0] : -1,
                           link ? link[3] : 0, span->last};
        for (int j = AT_TIMES; j < PART; j++) {
            part[j] = at;
            at += (sizes[j - AT_TIMES] + 7) / 8 * 8;
        }
        if (header) memcpy(header + HEADER + (size_t)i * PART, part, sizeof part);
    }
    if (header) header[NUM_PARTS] = count;
    return at;
}

/* Lets the solver write its policy into a plan, of which the header is complete. */
static void put_policy_into(const Receding *r, const Plan *plan)
{
    const Horizon *h = r->horizon;
    for (int i = 0; i < r->problem->num_phases; i++) {
        Phase *ph = &r->problem->phases[i];
        const long *part = part_of(plan, i);
        ph->k = plan->numbers + part[AT_K], ph->K = plan->numbers + part[AT_FEEDBACK];
        if (!h->lean) ph->Q_x = plan->numbers + part[AT_Q_X], ph->Q_xx = plan->numbers + part[AT_Q_XX];
        if (!is_read(h, (int)part[MODE])) continue;
        ph->Q_u = plan->numbers + part[AT_Q_U], ph->Q_ux = plan->numbers + part[AT_Q_UX], ph->Q_uu = plan->numbers + part[AT_Q_UU];
    }
}

/* Lays the parts and nodes of the horizon that begins at tick k; returns the number of parts. */
static int lay(Receding *r, long k)
{
    int count = lay_spans(r->horizon, k, r->spans), at = 0;
    for (int i = 0; i < count; i++) {
        r->firsts[i] = at;
        at += lay_nodes(r->horizon, &r->spans[i], r->nodes + at);
    }
    r->num_nodes = at;
    return count;
}

void receding_sizes(Receding *r, long k, size_t *bytes, long *numbers, long *entries)
{
    Arena measure = {0}, before = {0};
    const int count = lay(r, k);
    lay_out(r, &measure, count);
    lay_out_node(r, &before);
    *bytes = (measure.used > before.used ? measure.used : before.used) + 64;
    *numbers = lay_plan(r, count, NULL);
    *entries = HEADER + (long)count * PART;
}

static void copy(double *to, const double *from, size_t n) { memcpy(to, from, sizeof(double) * n); }

/* Without a policy, gains and expansions are zero, and not those of a sweep that was broken off. */
static void clear_policy(Problem *pr)
{
    for (int i = 0; i < pr->num_phases; i++) {
        const Phase *ph = &pr->phases[i];
        const size_t N = (size_t)ph->N, nu = (size_t)ph->mode->nu, ndx = (size_t)ph->mode->ndx;
        memset(ph->k, 0, sizeof(double) * N * nu);
        memset(ph->K, 0, sizeof(double) * N * nu * ndx);
        if (ph->Q_x) memset(ph->Q_x, 0, sizeof(double) * N * ndx);
        if (ph->Q_xx) memset(ph->Q_xx, 0, sizeof(double) * N * ndx * ndx);
        if (!ph->Q_u) continue;
        memset(ph->Q_u, 0, sizeof(double) * N * nu);
        memset(ph->Q_ux, 0, sizeof(double) * N * nu * ndx);
        memset(ph->Q_uu, 0, sizeof(double) * N * nu * nu);
    }
}

/* Whether the cost, the defects, the states, controls and gains of a plan are finite, so that the next one can begin with them. */
static int is_finite(const Horizon *h, const Plan *plan)
{
    int finite = isfinite(plan->numbers[COST] + plan->numbers[DEFECT]) != 0;
    for (int i = 0; i < plan->header[NUM_PARTS]; i++) {
        const long *part = part_of(plan, i), N = part[STAGES];
        const Mode *m = h->mode_tables[part[MODE]];
        const long at[] = {part[AT_X], part[AT_U], part[AT_K], part[AT_FEEDBACK]};
        const long sizes[] = {(N + 1) * m->nx, N * m->nu, N * m->nu, N * m->nu * m->ndx};
        for (int a = 0; a < 4; a++)
            for (long j = 0; j < sizes[a]; j++) finite &= isfinite(plan->numbers[at[a] + j]) != 0;
    }
    return finite;
}

/* Copies the iterate of the solver into a plan; the policy is there. */
static void write_plan(const Receding *r, const Plan *plan)
{
    const Horizon *h = r->horizon;
    const Problem *pr = r->problem;
    double *out = plan->numbers;
    for (int i = 0; i < pr->num_phases; i++) {
        const Phase *ph = &pr->phases[i];
        const Mode *m = ph->mode;
        const long *part = part_of(plan, i);
        const size_t N = (size_t)ph->N;
        for (int k = 0; k <= ph->N; k++) out[part[AT_TIMES] + k] = (double)(part[FIRST] + k * h->segments[part[SEGMENT]].step + r->clock.shift) * h->tick;
        copy(out + part[AT_X], ph->x, (N + 1) * (size_t)m->nx);
        copy(out + part[AT_U], ph->u, N * (size_t)m->nu);
    }
    for (int g = 0; g < pr->num_groups; g++) {
        const Mode *m = pr->groups[g].mode;
        for (int i = 0; is_read(h, g) && i < pr->groups[g].num_blocks; i++) {
            const Block *b = &pr->groups[g].blocks[i];
            for (int l = 0; l < b->count; l++) {
                const long *part = part_of(plan, b->phase[l]);
                double *gs = out + part[AT_G_MASK] + (long)b->index[l] * m->ng, *hs = out + part[AT_H_MASK] + (long)b->index[l] * m->nh;
                for (int j = 0; j < m->ng; j++) gs[j] = b->g_mask[j * W + l];
                for (int j = 0; j < m->nh; j++) hs[j] = b->h_mask[j * W + l];
            }
        }
    }
    for (int g = 0; g < pr->num_transitions; g++)
        for (int i = 0; i < pr->transitions[g].num_blocks; i++) {
            const Block *b = &pr->transitions[g].blocks[i];
            for (int l = 0; l < b->count; l++)
                for (int j = 0; j < pr->transitions[g].transition->np; j++)
                    out[part_of(plan, b->phase[l])[AT_P_TRANSITION] + j] = b->p[j * W + l];
        }
}

void receding_view(const Horizon *h, const Plan *plan)
{
    int n = 0;
    for (; n < plan->header[NUM_PARTS]; n++) {
        const long *part = part_of(plan, n);
        const int mode = h->followed[part[MODE]];
        const double *at = plan->numbers;
        if (mode < 0) break;
        plan->phases[n] = (struct plan_phase){
            mode, (int)part[STAGES], at + part[AT_TIMES], at + part[AT_X], at + part[AT_U], at + part[AT_FEEDBACK],
            at + part[AT_Q_U], at + part[AT_Q_UX], at + part[AT_Q_UU], at + part[AT_P], at + part[AT_G_MASK], at + part[AT_H_MASK]};
    }
    *plan->view = (struct plan){n, plan->phases, {plan->numbers[ANCHOR], plan->numbers[ANCHOR + 1], plan->numbers[ANCHOR + 2]}};
}

/* The tick of the world's clock at which a plan of a state that is measured at time t begins. */
static long begin_of(const Receding *r, double t)
{
    const Segment *first = &r->horizon->segments[0];
    return (long)ceil((t + r->latency - SAME_TIME) / first->dt) * first->step;
}

/* Whether a plan can begin: 0, or why not. */
static int check_measured(const Receding *r, const double *x, double t)
{
    const Horizon *h = r->horizon;
    for (int i = 0; i < h->spaces[h->segments[0].space].nx; i++)
        if (!isfinite(x[i])) return NOT_FINITE_STATE;
    return fabs(t + r->latency) / h->tick < 1e15 ? PLANNED : OUTSIDE; /* ticks are whole numbers; t may be NaN */
}

/* Lays out the memory for single nodes, before that of a solve. */
static void work_on_nodes(Receding *r)
{
    r->arena.used = 0;
    lay_out_node(r, &r->arena);
}

/* The state in the world at a later time under the last plan, from one measured at time t; returns whether it is finite. */
static int state_later(Receding *r, const double *x, double t, double until, double *state)
{
    const Horizon *h = r->horizon;
    const Space *space = &h->spaces[h->segments[0].space];
    memcpy(state, x, sizeof(double) * (size_t)space->nx);
    if (!r->has_plan || until <= t + SAME_TIME) return 1;
    work_on_nodes(r);
    const long measured = lround(t / h->tick) - r->clock.shift;
    to_frame(r, x, r->course.anchor, state);
    if (measured >= r->course.tick && fabs((double)(measured + r->clock.shift) * h->tick - t) < SAME_TIME) arrive(r, measured, state);
    predict(r, state, t, until);
    move_values(r, space->state, space->nx, state, r->course.anchor, state);
    int finite = 1;
    for (int i = 0; i < space->nx; i++) finite &= isfinite(state[i]) != 0;
    return finite;
}

/* Makes a plan that begins at a tick of the world's clock with a state in the world, from one that was measured at time t. */
static int plan_from(Receding *r, double began, const double *state, long begin, double t, const Plan *plan)
{
    const Horizon *h = r->horizon;
    Problem *pr = r->problem;
    const size_t bytes = sizeof(double) * (size_t)h->spaces[h->segments[0].space].nx;
    const long step = h->segments[0].step;
    double start[MOST_NUMBERS];
    work_on_nodes(r);
    const Clock before = r->clock;
    retime(r, state, begin);
    const long k = begin - r->clock.shift;
    if (k < 0 || (h->total >= 0 && k > h->total - step)) {
        r->clock = before; /* no plan, so its state has not moved the clock */
        return OUTSIDE;
    }
    if (r->has_plan) advance_course(r, state, k, &r->course);
    else begin_course(r, state, k, &r->course);
    to_frame(r, state, r->course.anchor, start);
    arrive(r, k, start);
    const int count = lay(r, k);
    r->arena.used = 0;
    lay_out(r, &r->arena, count);
    lay_plan(r, count, plan->header);
    put_policy_into(r, plan);
    make_samples(r, r->nodes, r->num_nodes, r->samples);
    for (int i = 0; i < count; i++) take_middles(h, &r->spans[i], r->samples + (size_t)r->firsts[i] * (size_t)h->num_targets);
    fill_problem(r, plan);
    shift_plan(r, start, r->clock.shift - before.shift);
    memcpy((double *)pr->initial, start, bytes);
    pr->options = r->options;
    keep_rows(r, r->clock.shift - before.shift);
    pr->options.max_iterations = r->began ? r->iterations : r->first_iterations;
    if (!r->began) pr->options.time_limit_s = 0.0; /* the first plan has no limit of time */
    pr->num_records = pr->cancel = 0;
    const double filled = h->clock(pr);
    int status = h->solve(pr, 0);
    const double solved = h->clock(pr);
    plan->header[HAS_POLICY] = h->policy(pr);
    if (!plan->header[HAS_POLICY]) clear_policy(pr);
    plan->header[TICK] = k, plan->header[STATUS] = status, plan->header[ITERATIONS] = pr->num_records;
    plan->header[MOTION] = plan->header[REQUEST] = 0;
    write_plan(r, plan);
    adapt_rows(r, plan, status);
    double *f = plan->numbers;
    memcpy(f + ANCHOR, r->course.anchor, sizeof(double) * 3);
    memcpy(f + MOVED, r->course.moved, sizeof(double) * 3);
    f[COST] = pr->cost, f[DEFECT] = pr->max_defect, f[EQUALITY] = pr->max_equality, f[INEQUALITY] = pr->max_inequality;
    f[MEASURED_AT] = t, f[SHIFT] = (double)r->clock.shift * h->tick;
    f[NUMBERS_S] = filled - began, f[SOLVE_S] = solved - filled, f[POLICY_S] = h->clock(pr) - solved;
    receding_view(h, plan);
    r->last = *plan, r->began = 1;
    r->has_plan = is_finite(h, plan);
    return r->has_plan ? PLANNED : NOT_FINITE_PLAN;
}

int receding_plan(void *receding, const double *x, double t, const Plan *plan)
{
    Receding *r = receding;
    const double began = r->horizon->clock(r->problem);
    const int why = check_measured(r, x, t);
    if (why) return why;
    const Segment *first = &r->horizon->segments[0];
    const size_t bytes = sizeof(double) * (size_t)r->horizon->spaces[first->space].nx;
    const long begin = begin_of(r, t);
    double state[MOST_NUMBERS];
    if (!state_later(r, x, t, (double)(begin / first->step) * first->dt, state)) {
        r->has_plan = 0; /* the policy is far from its plan */
        memcpy(state, x, bytes);
    }
    return plan_from(r, began, state, begin, t, plan);
}

#include "motions.inc"
