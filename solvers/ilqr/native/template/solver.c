/* Multi-phase multiple-shooting iLQR: the algorithm of solvers/run.py and solvers/outer.py, without Python and without allocation. */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <string.h>
#include <time.h>

#include "piaffe.h"

enum { PATIENCE = 8 };
static const double NEARLY_CLOSED = 0.05, SAME = 1e-9, LOG_OF_2 = 0.693147180559945309;

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* ---- manifolds */

static void plus(const Mode *m, const double *x, const double *dx, double size, double *out)
{
    for (int part = 0; part < m->num_parts; part++) {
        int n = m->part_size[part];
        if (m->part_is_rotation[part]) {
            double p[3] = {size * dx[0], size * dx[1], size * dx[2]};
            double angle = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
            double c = cos(angle / 2), s = angle > 1e-8 ? sin(angle / 2) / angle : 0.5;
            double b[4] = {c, s * p[0], s * p[1], s * p[2]}, q[4];
            q[0] = x[0] * b[0] - x[1] * b[1] - x[2] * b[2] - x[3] * b[3];
            q[1] = x[0] * b[1] + b[0] * x[1] + x[2] * b[3] - x[3] * b[2];
            q[2] = x[0] * b[2] + b[0] * x[2] + x[3] * b[1] - x[1] * b[3];
            q[3] = x[0] * b[3] + b[0] * x[3] + x[1] * b[2] - x[2] * b[1];
            double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
            for (int i = 0; i < 4; i++) out[i] = q[i] / norm;
            x += 4, out += 4, dx += 3;
        } else {
            for (int i = 0; i < n; i++) out[i] = x[i] + size * dx[i];
            x += n, out += n, dx += n;
        }
    }
}

static void minus(const Mode *m, const double *a, const double *b, double *out) /* a (-) b */
{
    for (int part = 0; part < m->num_parts; part++) {
        int n = m->part_size[part];
        if (m->part_is_rotation[part]) {
            double q[4];
            q[0] = b[0] * a[0] + b[1] * a[1] + b[2] * a[2] + b[3] * a[3];
            q[1] = b[0] * a[1] - b[1] * a[0] - b[2] * a[3] + b[3] * a[2];
            q[2] = b[0] * a[2] - b[2] * a[0] - b[3] * a[1] + b[1] * a[3];
            q[3] = b[0] * a[3] - b[3] * a[0] - b[1] * a[2] + b[2] * a[1];
            double sign = q[0] < 0 ? -1.0 : 1.0;
            double s = sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
            double f = sign * (s > 1e-12 ? 2 * atan2(s, sign * q[0]) / s : 2.0);
            for (int i = 0; i < 3; i++) out[i] = f * q[i + 1];
            a += 4, b += 4, out += 3;
        } else {
            for (int i = 0; i < n; i++) out[i] = a[i] - b[i];
            a += n, b += n, out += n;
        }
    }
}

/* ---- the relaxed barrier, solvers/barrier.py, lane by lane */

static vd time_steps(const Block *b)
{
    vd dt;
    memcpy(&dt, b->dt, sizeof dt);
    return dt;
}

static vi rows_in_use(vd mask) { return LANE_TRUE(mask != K(0.0)); }

/* A sum of logarithms as that of a product, which is kept as mantissa and exponent: one call per lane, not one per row. */
typedef struct {
    vd mantissa;
    vi exponent;
} Product;

static inline void times(Product *p, vd factor) /* positive and normal */
{
    vi bits = lane_bits(p->mantissa * factor);
    p->exponent += (bits >> 52) - 1023;
    p->mantissa = lane_from((bits & 0xfffffffffffff) | lane_bits(K(1.0)));
}

static inline vd logarithm(const Product *p)
{
    vd sum = lane_log(p->mantissa);
    for (int l = 0; l < W; l++) {
        double exponent = (double)LANE_OF(p->exponent, l);
        LANE_OF(sum, l) += exponent * LOG_OF_2;
    }
    return sum;
}

/* Sum over rows of the barrier's values; raises `worst` to the largest violation in each lane. */
static vd barrier_values(const Block *b, int ng, vd *worst)
{
    const vd *gs = (const vd *)b->g, *shift = (const vd *)b->shift, *relaxation = (const vd *)b->relaxation;
    const vd *mask = (const vd *)b->g_mask;
    Product product = {K(1.0), lane_bits(K(0.0))};
    vd sum = K(0.0);
    for (int r = 0; r < ng; r++) {
        vi used = rows_in_use(mask[r]);
        vd g = gs[r] - shift[r], delta = relaxation[r], ratio = (g - K(2.0) * delta) / delta;
        vi inside = LANE_TRUE(g > delta);
        vd log_of = lane_select(inside, g, delta);
        vd rest = lane_select(inside, K(0.0) * g, K(0.5) * (ratio * ratio - K(1.0))); /* 0 g: an infinite g is no number */
        times(&product, lane_select(used, log_of, K(1.0)));
        sum += lane_keep(used, rest);
        *worst = lane_select(used & LANE_TRUE(-gs[r] > *worst), -gs[r], *worst);
    }
    return sum - logarithm(&product);
}

/* Slope and curvature of the barrier at g. */
static inline void barrier_derivatives(vd g, vd delta, vd *slope, vd *curvature)
{
    vi inside = LANE_TRUE(g > delta);
    vd inverse = K(1.0) / lane_select(inside, g, delta);
    *curvature = inverse * inverse;
    *slope = lane_select(inside, -inverse, (g - K(2.0) * delta) * *curvature);
}

/* ---- evaluation of a trial */

typedef struct {
    double cost, penalty, gap, max_defect, max_h, max_g;
} Sums;

static void block_sums(const Block *b, int nr, int ng, int nh, double weight, int is_end, Sums *s)
{
    const vd *weights = (const vd *)b->weight, *residual = (const vd *)b->residual;
    const vd *hs = (const vd *)b->h, *mask = (const vd *)b->h_mask;
    const vd *multiplier = (const vd *)b->multiplier, *penalties = (const vd *)b->penalty;
    vd dt = time_steps(b), scale = is_end ? K(1.0) : dt, cost = K(0.0), penalty = K(0.0), max_g = K(0.0), max_h = K(0.0);
    for (int r = 0; r < nr; r++) cost += weights[r] * residual[r] * residual[r];
    for (int r = 0; r < nh; r++) {
        vi used = rows_in_use(mask[r]);
        vd h = hs[r], size = lane_fabs(h);
        penalty += lane_keep(used, K(0.5) * penalties[r] * h * h + multiplier[r] * h);
        max_h = lane_select(used & LANE_TRUE(size > max_h), size, max_h);
    }
    cost *= K(0.5) * scale;
    penalty *= scale;
    if (ng) penalty += dt * K(weight) * barrier_values(b, ng, &max_g);
    for (int l = 0; l < b->count; l++) {
        s->cost += LANE_OF(cost, l);
        s->penalty += LANE_OF(penalty, l);
        s->max_g = fmax(s->max_g, LANE_OF(max_g, l));
        s->max_h = fmax(s->max_h, LANE_OF(max_h, l));
    }
}

static const double *node(const Phase *ph, int k, int trial) { return (trial ? ph->xt : ph->x) + (size_t)k * ph->mode->nx; }

static void each_stage(Problem *pr, const Block *b, int trial, const double **x, const double **u, double **x_next)
{
    for (int l = 0; l < W; l++) {
        int at = l < b->count ? l : 0;
        Phase *ph = &pr->phases[b->phase[at]];
        x[l] = node(ph, b->index[at], trial);
        u[l] = (trial ? ph->ut : ph->u) + (size_t)b->index[at] * ph->mode->nu;
        x_next[l] = ph->x_next + (size_t)b->index[at] * ph->mode->nx;
    }
}

/* Evaluate the trial everywhere; all nodes at once. */
static void evaluate(Problem *pr)
{
    const double *x[W], *u[W];
    double *next[W];
    for (int g = 0; g < pr->num_groups; g++) {
        Group *gr = &pr->groups[g];
        for (int i = 0; i < gr->num_blocks; i++) {
            each_stage(pr, &gr->blocks[i], 1, x, u, next);
            gr->mode->values(&gr->blocks[i], x, u, next);
        }
        for (int i = 0; i < gr->num_ends; i++) {
            Block *b = &gr->ends[i];
            for (int l = 0; l < W; l++) {
                Phase *ph = &pr->phases[b->phase[l < b->count ? l : 0]];
                x[l] = node(ph, ph->N, 1);
            }
            gr->mode->end_values(b, x);
        }
    }
    for (int g = 0; g < pr->num_links; g++) {
        Group *gr = &pr->links[g];
        for (int i = 0; i < gr->num_blocks; i++) {
            Block *b = &gr->blocks[i];
            for (int l = 0; l < W; l++) {
                Phase *ph = &pr->phases[b->phase[l < b->count ? l : 0]];
                x[l] = node(ph, ph->N, 1);
                next[l] = ph->next->start;
            }
            gr->transition->values(b, x, next);
        }
    }
}

/* Sum and largest of the sizes of n numbers, eight at a time. */
static void add_sizes(const double *d, int n, Sums *s)
{
    double sum[8] = {0}, most[8] = {0};
    int j = 0;
    for (; j + 8 <= n; j += 8)
        for (int l = 0; l < 8; l++) {
            double size = fabs(d[j + l]);
            sum[l] += size;
            most[l] = size > most[l] ? size : most[l];
        }
    for (; j < n; j++) {
        sum[0] += fabs(d[j]);
        most[0] = fmax(most[0], fabs(d[j]));
    }
    for (int l = 0; l < 8; l++) {
        s->gap += sum[l];
        s->max_defect = fmax(s->max_defect, most[l]);
    }
}

static void trial_defects(Problem *pr, Sums *s)
{
    for (int i = 0; i < pr->num_phases; i++) {
        Phase *ph = &pr->phases[i];
        const Mode *m = ph->mode;
        for (int k = 0; k <= ph->N; k++) {
            double *d = ph->dt_trial + (size_t)k * m->ndx;
            const double *from = k ? ph->x_next + (size_t)(k - 1) * m->nx : (i ? ph->start : pr->initial);
            minus(m, from, node(ph, k, 1), d);
        }
        add_sizes(ph->dt_trial, (ph->N + 1) * m->ndx, s);
    }
    if (isnan(s->gap)) s->max_defect = NAN; /* which no maximum takes up */
}

static Sums sums_of_trial(Problem *pr)
{
    Sums s = {0};
    for (int g = 0; g < pr->num_groups; g++) {
        Group *gr = &pr->groups[g];
        const Mode *m = gr->mode;
        for (int i = 0; i < gr->num_blocks; i++) block_sums(&gr->blocks[i], m->nr, m->ng, m->nh, pr->weight, 0, &s);
        for (int i = 0; i < gr->num_ends; i++) block_sums(&gr->ends[i], m->mr, m->mg, m->mh, pr->weight, 1, &s);
    }
    trial_defects(pr, &s);
    return s;
}

/* Make the trial the accepted iterate. */
static void swap(double **a, double **b) { double *t = *a; *a = *b; *b = t; }

static void accept(Problem *pr)
{
    for (int i = 0; i < pr->num_phases; i++) {
        Phase *ph = &pr->phases[i];
        swap(&ph->x, &ph->xt);
        swap(&ph->u, &ph->ut);
        swap(&ph->d, &ph->dt_trial);
    }
    for (int kind = 0; kind < 2; kind++)
        for (int g = 0; g < (kind ? pr->num_links : pr->num_groups); g++) {
            Group *gr = kind ? &pr->links[g] : &pr->groups[g];
            for (int e = 0; e < 2; e++)
                for (int i = 0; i < (e ? gr->num_ends : gr->num_blocks); i++) {
                    Block *b = e ? &gr->ends[i] : &gr->blocks[i];
                    swap(&b->z, &b->z0);
                    swap(&b->residual, &b->residual0);
                    swap(&b->g, &b->g0);
                    swap(&b->h, &b->h0);
                    swap(&b->factors, &b->factors0);
                }
        }
}

/* ---- the linear-quadratic model at the accepted iterate */

static void rows(const Problem *pr, const Block *b, int nr, int ng, int nh, int is_end)
{
    vd *s = (vd *)pr->slope, *c = (vd *)pr->curvature, dt = time_steps(b), scale = is_end ? K(1.0) : dt;
    const vd *weight = (const vd *)b->weight, *residual = (const vd *)b->residual0;
    for (int r = 0; r < nr; r++) {
        c[r] = scale * weight[r];
        s[r] = c[r] * residual[r];
    }
    s += nr, c += nr;
    const vd *g = (const vd *)b->g0, *shift = (const vd *)b->shift, *relaxation = (const vd *)b->relaxation;
    for (int r = 0; r < ng; r++) {
        vd weighs = dt * K(pr->weight) * ((const vd *)b->g_mask)[r], slope, curvature;
        barrier_derivatives(g[r] - shift[r], relaxation[r], &slope, &curvature);
        s[r] = lane_keep(rows_in_use(weighs), weighs * slope);
        c[r] = lane_keep(rows_in_use(weighs), weighs * curvature);
    }
    s += ng, c += ng;
    const vd *h = (const vd *)b->h0, *multiplier = (const vd *)b->multiplier, *penalty = (const vd *)b->penalty;
    for (int r = 0; r < nh; r++) {
        vd weighs = scale * ((const vd *)b->h_mask)[r];
        s[r] = lane_keep(rows_in_use(weighs), weighs * (penalty[r] * h[r] + multiplier[r]));
        c[r] = weighs * penalty[r];
    }
}

/* Kernels write only what may differ from zero. */
static void clear(Problem *pr)
{
    for (int i = 0; i < pr->num_phases; i++) {
        Phase *ph = &pr->phases[i];
        size_t n = (size_t)ph->mode->ndx, w = n + (size_t)ph->mode->nu, N = (size_t)ph->N;
        memset(ph->D, 0, sizeof(double) * N * n * w);
        memset(ph->H, 0, sizeof(double) * N * w * w);
        memset(ph->end_H, 0, sizeof(double) * n * n);
        if (ph->next) memset(ph->P, 0, sizeof(double) * (size_t)ph->next->mode->ndx * n);
    }
    pr->cleared = 1;
}

static void linearise(Problem *pr)
{
    if (!pr->cleared) clear(pr);
    const double *x[W], *u[W], *xn[W];
    double *a[W], *b_[W], *c[W], *unused[W];
    for (int g = 0; g < pr->num_groups; g++) {
        Group *gr = &pr->groups[g];
        const Mode *m = gr->mode;
        int nw = m->ndx + m->nu;
        for (int i = 0; i < gr->num_blocks; i++) {
            Block *b = &gr->blocks[i];
            each_stage(pr, b, 0, x, u, unused);
            for (int l = 0; l < W; l++) {
                int at = l < b->count ? l : 0, n = b->index[at];
                Phase *ph = &pr->phases[b->phase[at]];
                xn[l] = node(ph, n + 1, 0);
                a[l] = ph->D + (size_t)n * m->ndx * nw;
                b_[l] = ph->grad + (size_t)n * nw;
                c[l] = ph->H + (size_t)n * nw * nw;
            }
            rows(pr, b, m->nr, m->ng, m->nh, 0);
            m->lq(b, x, u, xn, pr->slope, pr->curvature, a, b_, c);
        }
        for (int i = 0; i < gr->num_ends; i++) {
            Block *b = &gr->ends[i];
            for (int l = 0; l < W; l++) {
                Phase *ph = &pr->phases[b->phase[l < b->count ? l : 0]];
                x[l] = node(ph, ph->N, 0);
                a[l] = ph->end_grad;
                c[l] = ph->end_H;
            }
            rows(pr, b, m->mr, m->mg, m->mh, 1);
            m->end_lq(b, x, pr->slope, pr->curvature, a, c);
        }
    }
    for (int g = 0; g < pr->num_links; g++) {
        Group *gr = &pr->links[g];
        for (int i = 0; i < gr->num_blocks; i++) {
            Block *b = &gr->blocks[i];
            for (int l = 0; l < W; l++) {
                Phase *ph = &pr->phases[b->phase[l < b->count ? l : 0]];
                x[l] = node(ph, ph->N, 0);
                xn[l] = node(ph->next, 0, 0);
                a[l] = ph->P;
            }
            gr->transition->lq(b, x, xn, a);
        }
    }
}

/* ---- Riccati sweep and linear roll-out over the phases, solvers/riccati.py */

static int backward(Problem *pr, double regularization)
{
    for (int i = pr->num_phases - 1; i >= 0; i--) {
        Phase *ph = &pr->phases[i];
        ph->mode->end_value(ph);
        if (!ph->mode->backward(ph, regularization)) return 0;
        for (int j = 0; j < ph->mode->ndx; j++)
            if (!isfinite(ph->V_x[j])) return 0;
    }
    return 1;
}

static void forward(Problem *pr, int correction, double dV[2])
{
    if (dV) dV[0] = dV[1] = 0.0;
    Phase *first = &pr->phases[0];
    memcpy(first->dx, correction ? first->dt_trial : first->d, sizeof(double) * (size_t)first->mode->ndx);
    for (int i = 0; i < pr->num_phases; i++) {
        Phase *ph = &pr->phases[i];
        const double *after = !ph->next ? NULL : correction ? ph->next->dt_trial : ph->next->d;
        ph->mode->forward(ph, correction ? ph->dt_trial : ph->d, after, !correction, dV);
    }
}

/* ---- line search, solvers/run.py */

/* The iterate a step away, from the accepted one or (a correction) from the trial itself. */
static void move(Problem *pr, int from_trial, double size)
{
    for (int i = 0; i < pr->num_phases; i++) {
        Phase *ph = &pr->phases[i];
        const Mode *m = ph->mode;
        const double *x = from_trial ? ph->xt : ph->x, *u = from_trial ? ph->ut : ph->u;
        for (int k = 0; k <= ph->N; k++)
            plus(m, x + (size_t)k * m->nx, ph->dx + (size_t)k * m->ndx, size, ph->xt + (size_t)k * m->nx);
        for (int k = 0; k < ph->N * m->nu; k++) ph->ut[k] = u[k] + size * ph->du[k];
    }
}

static double augmented_of_accepted(Problem *pr)
{
    Sums s = {0};
    for (int g = 0; g < pr->num_groups; g++) {
        Group *gr = &pr->groups[g];
        const Mode *m = gr->mode;
        for (int e = 0; e < 2; e++)
            for (int i = 0; i < (e ? gr->num_ends : gr->num_blocks); i++) {
                Block b = e ? gr->ends[i] : gr->blocks[i];
                b.residual = b.residual0, b.g = b.g0, b.h = b.h0;
                if (e) block_sums(&b, m->mr, m->mg, m->mh, pr->weight, 1, &s);
                else block_sums(&b, m->nr, m->ng, m->nh, pr->weight, 0, &s);
            }
    }
    return s.cost + s.penalty;
}

/* A copy of the trial, whose merit is not finite. */
static void keep_outside(Problem *pr)
{
    pr->blocked = 1;
    for (int i = 0; i < pr->num_phases; i++) {
        Phase *ph = &pr->phases[i];
        memcpy(ph->x_outside, ph->xt, sizeof(double) * (size_t)((ph->N + 1) * ph->mode->nx));
        memcpy(ph->u_outside, ph->ut, sizeof(double) * (size_t)(ph->N * ph->mode->nu));
    }
}

static double search(Problem *pr, const double dV[2], Sums *at)
{
    const Options *o = &pr->options;
    double gap = at->gap, change = dV[0] + 0.5 * fmax(dV[1], 0.0);
    double needed = gap > 1e-12 ? fmax(change, 0.0) / ((1 - o->merit_margin) * gap) : 0.0;
    if (pr->inner > 4 * o->max_inner && pr->inner % o->max_inner == 0) pr->least_rho *= 2;
    pr->rho = fmax(fmax(needed, 0.98 * pr->rho), pr->least_rho);
    double before = augmented_of_accepted(pr) + pr->rho * gap;
    int left = 0;
    double size = pr->last_step > 0 ? fmin(1.0, pr->last_step / (o->step_shrink * o->step_shrink * o->step_shrink)) : 1.0;
    while (size >= o->min_step) {
        double expected = size * dV[0] + 0.5 * size * size * dV[1] - size * pr->rho * gap;
        double bound = before + o->armijo * expected + 1e-12 * fabs(before);
        int corrected = 0;
        move(pr, 0, size);
        for (int correction = 0; correction <= o->corrections; correction++) {
            evaluate(pr);
            Sums s = sums_of_trial(pr);
            double merit = s.cost + s.penalty + pr->rho * s.gap;
            if (!isfinite(merit)) keep_outside(pr), left = 1;
            if (isfinite(merit) && merit <= bound) {
                accept(pr);
                pr->blocked = left;
                *at = s;
                pr->gains[pr->num_gains++ % PATIENCE] = before - merit;
                return size;
            }
            if (!isfinite(merit) || s.gap <= (1 - 0.9 * size) * gap || correction == o->corrections) break;
            forward(pr, 1, NULL); /* overwrites the step, which is rolled out again below */
            corrected = 1;
            move(pr, 1, 1.0);
        }
        if (corrected) forward(pr, 0, (double[2]){0, 0});
        size *= o->step_shrink;
    }
    return 0.0;
}

/* ---- outer loop, solvers/outer.py; elementwise over lanes */

static double allowed(const Problem *pr) { return pr->options.barrier_gap * (1 + fabs(pr->cost)); }

static int gap_is_closed(const Problem *pr)
{
    return !pr->has_inequalities || (pr->has_last_cost && fabs(pr->cost - pr->last_cost) <= allowed(pr));
}

static double near_gap(const Problem *pr)
{
    double total = 0.0;
    for (int g = 0; g < pr->num_groups; g++)
        for (int i = 0; i < pr->groups[g].num_blocks; i++) {
            const Block *b = &pr->groups[g].blocks[i];
            for (int r = 0; r < pr->groups[g].mode->ng * W; r++)
                if (b->g_mask[r] > 0 && b->g0[r] < 10 * pr->options.relaxation) total += b->dt[r % W];
        }
    return pr->weight * total;
}

static void update_rows(Problem *pr, Block *b, int ng, int nh, double factor)
{
    const Options *o = &pr->options;
    double slack = 0.25 * o->max_inequality, floor_ = sqrt(pr->weight / o->max_stiffness);
    for (int r = 0; r < ng * W; r++) {
        if (!(b->g_mask[r] > 0)) continue;
        double g = b->g0[r], delta = b->relaxation[r];
        if (delta <= 1.01 * floor_ && (g < -slack || b->shift[r] > 0)) b->shift[r] = fmax(b->shift[r] - g, 0.0);
        if (g < -slack) {
            double needed = 2 * delta * delta / fmax(2 * delta - g, delta);
            needed = fmin(fmax(needed, delta / 3), 0.7 * delta);
            b->relaxation[r] = fmin(fmax(needed, fmin(floor_, delta)), delta);
        }
    }
    for (int r = 0; r < nh * W; r++) {
        if (b->h_mask[r] > 0) b->multiplier[r] += b->penalty[r] * b->h0[r];
        b->penalty[r] = fmin(b->penalty[r] * factor, o->max_penalty);
    }
}

static int is_soft(const Problem *pr, const Block *b, int ng, int nh, double floor_)
{
    const Options *o = &pr->options;
    for (int r = 0; r < ng * W; r++)
        if (b->g0[r] < -o->max_inequality && b->g_mask[r] > 0 && b->relaxation[r] > floor_) return 1;
    for (int r = 0; r < nh * W; r++)
        if (fabs(b->h0[r]) > o->max_equality && b->h_mask[r] > 0 && b->penalty[r] < o->max_penalty) return 1;
    return 0;
}

static void update(Problem *pr, const Sums *at, int stationary)
{
    const Options *o = &pr->options;
    if (stationary && at->max_g <= 10 * o->max_inequality && !gap_is_closed(pr)) {
        pr->last_cost = pr->cost;
        pr->has_last_cost = 1;
        pr->weight = fmax(pr->weight * o->barrier_factor, o->min_barrier_weight);
    } else if (!stationary && near_gap(pr) > allowed(pr)) {
        pr->has_last_cost = 0;
        pr->weight = fmax(pr->weight * o->barrier_factor, o->min_barrier_weight);
    }
    int slow = at->max_h > 0.25 * pr->last_equality && at->max_h > o->max_equality;
    pr->last_equality = at->max_h;
    int soft = 0;
    for (int g = 0; g < pr->num_groups; g++) {
        Group *gr = &pr->groups[g];
        for (int i = 0; i < gr->num_blocks; i++)
            update_rows(pr, &gr->blocks[i], gr->mode->ng, gr->mode->nh, slow ? o->penalty_factor : 1.0);
        for (int i = 0; i < gr->num_ends; i++)
            update_rows(pr, &gr->ends[i], gr->mode->mg, gr->mode->mh, slow ? o->penalty_factor : 1.0);
    }
    if (!stationary) return;
    double floor_ = 1.01 * sqrt(pr->weight / o->max_stiffness);
    for (int g = 0; g < pr->num_groups; g++) {
        Group *gr = &pr->groups[g];
        for (int i = 0; i < gr->num_blocks; i++) soft |= is_soft(pr, &gr->blocks[i], gr->mode->ng, gr->mode->nh, floor_);
        for (int i = 0; i < gr->num_ends; i++) soft |= is_soft(pr, &gr->ends[i], gr->mode->mg, gr->mode->mh, floor_);
    }
    double violation = fmax(at->max_h / o->max_equality, at->max_g / o->max_inequality);
    int stays = violation > 1 && violation > 0.98 * pr->last_violation && !soft;
    pr->unmoved = stays ? pr->unmoved + 1 : 0;
    pr->last_violation = violation;
}

/* ---- the loop */

static int direction(Problem *pr, double dV[2])
{
    const Options *o = &pr->options;
    while (pr->regularization_now <= o->max_regularization) {
        if (backward(pr, pr->regularization_now)) {
            forward(pr, 0, dV);
            if (isfinite(dV[0] + dV[1])) return 1;
        }
        pr->regularization_now = fmax(4 * pr->regularization_now, o->regularization);
    }
    return 0;
}

static int all_finite(const double *a, size_t n)
{
    double sum = 0.0; /* stays 0 unless some a is not finite */
    for (size_t i = 0; i < n; i++) sum += 0.0 * a[i];
    return sum == 0.0;
}

static int model_is_finite(const Problem *pr)
{
    for (int i = 0; i < pr->num_phases; i++) {
        const Phase *ph = &pr->phases[i];
        size_t n = (size_t)ph->mode->ndx, nw = n + (size_t)ph->mode->nu, N = (size_t)ph->N;
        if (!all_finite(ph->D, N * n * nw) || !all_finite(ph->grad, N * nw) || !all_finite(ph->end_grad, n)) return 0;
        if (ph->next && !all_finite(ph->P, (size_t)ph->next->mode->ndx * n)) return 0;
        for (size_t k = 0; k < N; k++)
            for (size_t r = 0; r < nw; r++)
                if (!all_finite(ph->H + (k * nw + r) * nw + r, nw - r)) return 0; /* the upper triangle is what is written */
        for (size_t r = 0; r < n; r++)
            if (!all_finite(ph->end_H + r * n + r, n - r)) return 0;
    }
    return 1;
}

/* Why there is no step: something is not finite, or nothing decreases the merit. */
static int failure(const Problem *pr) { return pr->blocked || !model_is_finite(pr) ? NOT_FINITE : LINE_SEARCH_FAILED; }

static int gained_nothing(const Problem *pr, double tolerance)
{
    if (pr->num_gains < PATIENCE) return 0;
    for (int i = 0; i < PATIENCE; i++)
        if (!(pr->gains[i] < tolerance)) return 0;
    return 1;
}

/* Whether an iterate looks stationary only because regularisation keeps steps where the merit is finite. Overwrites the step. */
static int is_blocked(Problem *pr, double tolerance)
{
    double dV[2];
    if (!backward(pr, pr->options.regularization)) return 0;
    forward(pr, 0, dV);
    return !(fabs(dV[0] + 0.5 * dV[1]) < tolerance);
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
    pr->last_equality = pr->last_violation = INFINITY;
}

/* `resumed`: 0 for a cold start; 1 if barrier and multipliers are those of an earlier solve; 2 if the state of the search is,
 * too, which holds only if the merit is still resume_merit. */
int piaffe_solve(Problem *pr, int resumed)
{
    const Options *o = &pr->options;
    double began = now(), dV[2];
    if (!resumed) pr->weight = o->barrier_weight, pr->has_last_cost = 0;
    if (resumed < 2) begin_search(pr);
    pr->num_records = pr->blocked = 0;
    pr->has_inequalities = 0;
    for (int g = 0; g < pr->num_groups; g++) {
        Group *gr = &pr->groups[g];
        for (int e = 0; e < 2; e++)
            for (int i = 0; i < (e ? gr->num_ends : gr->num_blocks); i++) {
                const Block *b = e ? &gr->ends[i] : &gr->blocks[i];
                for (int r = 0; r < (e ? gr->mode->mg : gr->mode->ng) * W; r++) pr->has_inequalities |= b->g_mask[r] > 0;
            }
    }
    evaluate(pr); /* the binding leaves the start in the trial arrays */
    Sums at = sums_of_trial(pr);
    accept(pr);
    note(pr, &at);
    if (!isfinite(at.cost + at.penalty + at.gap)) return NOT_FINITE;
    if (resumed == 2 && !(fabs(at.cost + at.penalty + pr->rho * at.gap - pr->resume_merit) <= SAME * (1 + fabs(pr->resume_merit)))) {
        begin_search(pr);
        pr->has_last_cost = pr->resume_converged;
        pr->last_cost = pr->resume_cost;
    }
    linearise(pr);
    for (;;) {
        if (pr->cancel) return INTERRUPTED;
        note(pr, &at);
        if (!direction(pr, dV)) return failure(pr);
        double tolerance = o->cost_tolerance * (1 + fabs(at.cost));
        int stationary = (fabs(dV[0] + 0.5 * dV[1]) < tolerance || gained_nothing(pr, tolerance)) && at.max_defect < o->max_defect;
        int met = at.max_h <= o->max_equality && at.max_g <= o->max_inequality;
        if (stationary && pr->blocked && pr->regularization_now > o->regularization) {
            if (is_blocked(pr, tolerance)) return NOT_FINITE;
            if (!direction(pr, dV)) return failure(pr);
        }
        if (stationary && met && gap_is_closed(pr)) return CONVERGED;
        if (pr->num_records >= o->max_iterations) return ITERATION_LIMIT;
        int due = pr->inner >= o->max_inner && at.max_defect < NEARLY_CLOSED && (!met || near_gap(pr) > allowed(pr));
        if (stationary || due) {
            update(pr, &at, stationary);
            pr->inner = pr->num_gains = 0;
            linearise(pr);
            if (pr->unmoved > 8) return INFEASIBLE;
            if (!direction(pr, dV)) return failure(pr);
        }
        if (o->time_limit_s > 0 && now() - began > o->time_limit_s) return TIME_LIMIT;
        double size = search(pr, dV, &at);
        pr->inner++;
        pr->last_step = size;
        if (size == 0.0) {
            for (int i = 0; i < 2; i++) pr->regularization_now = fmax(4 * pr->regularization_now, o->regularization);
        } else if (size > 0.4) {
            pr->regularization_now = pr->regularization_now > o->regularization ? pr->regularization_now / 4 : 0.0;
        } else if (size < 0.1) {
            pr->regularization_now = fmax(4 * pr->regularization_now, o->regularization);
        }
        note(pr, &at);
        pr->history[pr->num_records] = (Record){
            pr->num_records + 1, at.cost, augmented_of_accepted(pr) + pr->rho * at.gap, -(dV[0] + 0.5 * dV[1]),
            at.max_defect, at.max_h, at.max_g, size, pr->regularization_now, pr->weight, now() - began,
        };
        __sync_synchronize();
        pr->num_records++;
        if (pr->regularization_now > o->max_regularization) return failure(pr);
        if (size > 0.0) linearise(pr);
    }
}

/* The merit of the accepted iterate, with the barrier and multipliers as they are now. */
double piaffe_merit(Problem *pr) { return augmented_of_accepted(pr) + pr->rho * pr->gap; }

/* The policy and expansions at the accepted iterate, with the least regularisation that succeeds; 0 if none does. */
int piaffe_policy(Problem *pr)
{
    int found = 0;
    linearise(pr);
    for (int i = 0; i < pr->num_phases; i++) pr->phases[i].keep = 1;
    for (double r = 0.0; !found && r <= pr->options.max_regularization; r = fmax(10 * r, pr->options.regularization))
        found = backward(pr, r);
    for (int i = 0; i < pr->num_phases; i++) pr->phases[i].keep = 0; /* sweeps of a solve need not write all that */
    return found;
}

/* Least seconds of each part of an iteration at the accepted iterate, for benchmarks: evaluation and sums of a trial, linear-quadratic
 * model, backward sweep, linear roll-out. The trial is left as it was accepted. */
void piaffe_profile(Problem *pr, int repetitions, double seconds[5])
{
    for (int i = 0; i < 5; i++) seconds[i] = INFINITY;
    forward(pr, 0, (double[2]){0, 0});
    for (int r = 0; r < repetitions; r++) {
        double t[6];
        t[0] = now();
        move(pr, 0, 0.0);
        evaluate(pr);
        t[1] = now();
        Sums s = sums_of_trial(pr);
        pr->cost = s.cost;
        t[2] = now();
        linearise(pr);
        t[3] = now();
        backward(pr, pr->regularization_now);
        t[4] = now();
        forward(pr, 0, (double[2]){0, 0});
        t[5] = now();
        for (int i = 0; i < 5; i++) seconds[i] = fmin(seconds[i], t[i + 1] - t[i]);
    }
}
