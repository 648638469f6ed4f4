/* MuJoCo's step of a legged robot, PIAFFE_W samples at a time: smooth dynamics, limits of joints and balls that touch
   planes and boxes, solved by projected Gauss-Seidel with elliptic cones, then Euler's step.

   Formulas and their order are those of MuJoCo 4.0, so states agree with its to rounding. A constraint is worked on if
   it is active in one of the lanes; in the others its force stays zero. */
#include <string.h>

#include "functions.h"

#define TINY 1e-15       /* MuJoCo's mjMINVAL */
#define NEWTON 20        /* steps of Newton's method for a friction force, at most */
#define NEGLIGIBLE 1e-10 /* what ends it, and the increase of cost that undoes an update */

struct soft { double stiffness, damping, start, end, width, middle, power, inverse_mass; };
struct ground { int box; double place[3], axes[3][3], half[3]; };
struct contact { int ball, ground; double friction[2]; struct soft soft; };
struct limit { int dof; double lower, upper; struct soft soft; };

#include "scene.h"

#define GROUPS (LIMITS + CONTACTS)
#define ROWS (LIMITS + 3 * CONTACTS + 1)
#define NX (NQ + NV)

/* rows of one limit or contact */
struct group {
    int first, size, dof; /* rows; the degree of freedom whose chain the rows are over */
    vi active;
    const struct contact *contact; /* null for a limit */
};

struct memory {
    vd q[NQ], v[NV], warm[NV], u[NU];                                                  /* what a step changes, and control */
    vd unit[NQ], factor[FACTORS], inverse[NV], acceleration[NV], centre[3 * BALLS + 1], moves[MOVES + 1];
    vd jacobian[ROWS][CHAIN], half[ROWS][CHAIN], scaled[ROWS][CHAIN];                  /* J, J L^-1, J L^-1 D^-1 */
    vd softness[ROWS], reference[ROWS], residual[ROWS], force[ROWS], a[ROWS][ROWS];    /* R, a_ref, b, f, J M^-1 J' + R */
    vd before[ROWS], begun[ROWS];                                                      /* f a sweep ago, and when it began */
    struct group groups[GROUPS + 1];
    int num_groups, num_rows;
    vd work[smooth_SZ_W + 1];
};

LANE int any(vi mask)
{
#if PIAFFE_W == 1
    return mask != 0;
#elif PIAFFE_W == 4 && defined(__AVX__)
    return __builtin_ia32_movmskpd256((vd)mask) != 0;
#else
    long long all = 0;
    for (int l = 0; l < PIAFFE_W; l++)
        all |= mask[l];
    return all != 0;
#endif
}

LANE vd largest(vd a, vd b) { return lane_select(LANE_TRUE(a > b), a, b); }
LANE vd root(vd a)
{
#if PIAFFE_W == 1
    return sqrt(a);
#else
    vd r;
    for (int l = 0; l < PIAFFE_W; l++)
        r[l] = __builtin_sqrt(a[l]);
    return r;
#endif
}
LANE vd dot(const vd *a, const vd *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
LANE void cross(const vd *a, const vd *b, vd *to)
{
    to[0] = a[1] * b[2] - a[2] * b[1];
    to[1] = a[2] * b[0] - a[0] * b[2];
    to[2] = a[0] * b[1] - a[1] * b[0];
}

/* ---- what is active */

static vd impedance(const struct soft *soft, vd distance)
{
    if (soft->start == soft->end || soft->width <= TINY)
        return K(0.5 * (soft->start + soft->end));
    const vd x = lane_fabs(distance) / K(soft->width);
    vd y = x;
    if (soft->power == 2.0) {
        const vd low = x * x / K(soft->middle), rest = K(1.0) - x;
        y = lane_select(LANE_TRUE(x <= K(soft->middle)), low, K(1.0) - rest * rest / K(1.0 - soft->middle));
    } else if (soft->power != 1.0) {
        const vd low = lane_pow(x, K(soft->power)) / K(pow(soft->middle, soft->power - 1.0));
        const vd high = K(1.0) - lane_pow(lane_fabs(K(1.0) - x), K(soft->power)) / K(pow(1.0 - soft->middle, soft->power - 1.0));
        y = lane_select(LANE_TRUE(x <= K(soft->middle)), low, high);
    }
    return lane_select(LANE_TRUE(x >= K(1.0)), K(soft->end), K(soft->start) + y * K(soft->end - soft->start));
}

static struct group *begin(struct memory *m, int size, int dof, vi active, const struct contact *contact)
{
    struct group *g = m->groups + m->num_groups++;
    *g = (struct group){m->num_rows, size, dof, active, contact};
    m->num_rows += size;
    return g;
}

/* The first row's softness and reference; those of tangents, whose distance is none, follow from it. */
static void soften(struct memory *m, const struct group *g, const struct soft *soft, vd distance)
{
    const int i = g->first, size = chain_size[g->dof], *on = chain[g->dof];
    const vd strength = impedance(soft, distance);
    m->softness[i] = largest(K(TINY), (K(1.0) - strength) * K(soft->inverse_mass) / strength);
    if (g->contact) {
        const double *mu = g->contact->friction;
        m->softness[i + 1] = m->softness[i] / K(IMPRATIO);
        m->softness[i + 2] = m->softness[i + 1] * K(mu[0] * mu[0] / (mu[1] * mu[1]));
    }
    for (int r = i; r < i + g->size; r++) {
        vd speed = K(0.0);
        for (int a = 0; a < size; a++)
            speed += m->jacobian[r][a] * m->v[on[a]];
        m->reference[r] = K(-soft->damping) * speed;
    }
    m->reference[i] -= K(soft->stiffness) * strength * distance;
}

static void touch_limits(struct memory *m)
{
    for (int k = 0; k < LIMITS; k++) {
        const struct limit *limit = limits + k;
        const vd angle = m->q[limit->dof + 1], above = angle - K(limit->lower), below = K(limit->upper) - angle;
        const vi low = LANE_TRUE(above < K(0.0)), high = LANE_TRUE(below < K(0.0));
        if (!any(low | high))
            continue;
        const struct group *g = begin(m, 1, limit->dof, low | high, 0);
        const int last = chain_size[limit->dof] - 1;
        for (int a = 0; a < last; a++)
            m->jacobian[g->first][a] = K(0.0);
        m->jacobian[g->first][last] = lane_select(high, K(-1.0), K(1.0));
        soften(m, g, &limit->soft, lane_select(high, below, above));
    }
}

/* distance, normal out of the ground, and from the ball's centre to the point of contact */
static vd meet(const struct ground *ground, const vd *centre, double radius, vd *normal, vd *to_point)
{
    vd local[3], distance;
    for (int i = 0; i < 3; i++) {
        local[i] = K(0.0);
        for (int k = 0; k < 3; k++)
            local[i] += K(ground->axes[k][i]) * (centre[k] - K(ground->place[k]));
    }
    if (!ground->box) {
        for (int i = 0; i < 3; i++)
            normal[i] = K(ground->axes[i][2]);
        distance = local[2] - K(radius);
    } else {
        vd out[3], gap = K(0.0), nearest = K(1e30), inward[3] = {K(0.0), K(0.0), K(0.0)};
        for (int i = 0; i < 3; i++) {
            const vd half = K(ground->half[i]);
            const vd held = lane_select(LANE_TRUE(local[i] > half), half, lane_select(LANE_TRUE(local[i] < -half), -half, local[i]));
            out[i] = local[i] - held;
            gap += out[i] * out[i];
        }
        gap = root(gap);
        const vi inside = LANE_TRUE(gap <= K(TINY));
        if (any(inside)) /* the nearest face */
            for (int side = 0; side < 6; side++) {
                const int i = side / 2;
                const vd sign = K(side % 2 ? 1.0 : -1.0), away = lane_fabs(sign * K(ground->half[i]) - local[i]);
                const vi nearer = LANE_TRUE(away < nearest);
                nearest = lane_select(nearer, away, nearest);
                for (int k = 0; k < 3; k++)
                    inward[k] = lane_select(nearer, k == i ? sign : K(0.0), inward[k]);
            }
        const vd over = K(1.0) / largest(gap, K(TINY));
        for (int i = 0; i < 3; i++)
            out[i] = lane_select(inside, inward[i], out[i] * over);
        for (int k = 0; k < 3; k++)
            normal[k] = K(ground->axes[k][0]) * out[0] + K(ground->axes[k][1]) * out[1] + K(ground->axes[k][2]) * out[2];
        distance = lane_select(inside, -nearest, gap) - K(radius);
    }
    for (int k = 0; k < 3; k++)
        to_point[k] = -normal[k] * (K(radius) + K(0.5) * distance);
    return distance;
}

static void touch_ground(struct memory *m)
{
    for (int c = 0; c < CONTACTS; c++) {
        const struct contact *contact = contacts + c;
        vd normal[3], arm[3], across[3], axes[3][3];
        const vd distance = meet(grounds + contact->ground, m->centre + 3 * contact->ball, ball_radius[contact->ball], normal, arm);
        const vi active = LANE_TRUE(distance < K(0.0));
        if (!any(active))
            continue;
        const int dof = ball_dof[contact->ball], size = chain_size[dof];
        const struct group *g = begin(m, 3, dof, active, contact);
        const vi steep = LANE_TRUE(lane_fabs(normal[1]) < K(0.5)); /* tangents: of y, or of z where the normal is along y */
        const vd y = lane_keep(steep, K(1.0)), z = lane_keep(~steep, K(1.0));
        const vd along = y * normal[1] + z * normal[2];
        across[0] = -along * normal[0];
        across[1] = y - along * normal[1];
        across[2] = z - along * normal[2];
        const vd over = K(1.0) / root(dot(across, across));
        for (int k = 0; k < 3; k++) {
            axes[0][k] = normal[k];
            axes[1][k] = across[k] * over;
        }
        cross(axes[0], axes[1], axes[2]);
        const vd *moves = m->moves + ball_moves[contact->ball];
        for (int r = 0; r < 3; r++) {
            vd *row = m->jacobian[g->first + r];
            vd twist[3]; /* axis . (turn x arm) = turn . (arm x axis) */
            cross(arm, axes[r], twist);
            for (int k = 0; k < 3; k++)
                row[k] = axes[r][k];
            for (int a = 3; a < size; a++)
                row[a] = dot(axes[r], moves + 6 * (a - 3)) + dot(twist, moves + 6 * (a - 3) + 3);
        }
        soften(m, g, &contact->soft, distance);
    }
}

/* ---- their forces */

/* J L^-1, J L^-1 D^-1, J M^-1 J' + R and b = J a - a_ref */
static void project(struct memory *m)
{
    for (int k = 0; k < m->num_groups; k++) {
        const struct group *g = m->groups + k;
        const int size = chain_size[g->dof], *on = chain[g->dof];
        for (int r = g->first; r < g->first + g->size; r++) {
            vd *half = m->half[r], b = -m->reference[r];
            for (int a = 0; a < size; a++) {
                half[a] = m->jacobian[r][a];
                b += half[a] * m->acceleration[on[a]];
            }
            for (int a = size - 1; a > 0; a--) {
                const vd *row = m->factor + factor_start[on[a]];
                for (int p = 0; p < a; p++)
                    half[p] -= row[p] * half[a];
            }
            for (int a = 0; a < size; a++)
                m->scaled[r][a] = half[a] * m->inverse[on[a]];
            m->residual[r] = b;
        }
        for (int other = 0; other <= k; other++) {
            const struct group *o = m->groups + other;
            const int common = shared[g->dof][o->dof];
            for (int r = g->first; r < g->first + g->size; r++)
                for (int s = o->first; s < o->first + o->size; s++) {
                    vd sum = K(0.0);
                    for (int a = 0; a < common; a++)
                        sum += m->half[r][a] * m->scaled[s][a];
                    m->a[r][s] = m->a[s][r] = sum;
                }
        }
        for (int r = g->first; r < g->first + g->size; r++)
            m->a[r][r] += m->softness[r];
    }
}

/* Forces of the accelerations that the last step ended with; none where these would cost more than that. */
static void start(struct memory *m)
{
    for (int k = 0; k < m->num_groups; k++) {
        const struct group *g = m->groups + k;
        const int i = g->first, size = chain_size[g->dof], *on = chain[g->dof];
        vd jar[3];
        for (int r = 0; r < g->size; r++) {
            jar[r] = -m->reference[i + r];
            for (int a = 0; a < size; a++)
                jar[r] += m->jacobian[i + r][a] * m->warm[on[a]];
        }
        if (!g->contact) {
            m->force[i] = lane_keep(g->active & LANE_TRUE(jar[0] < K(0.0)), -jar[0] / m->softness[i]);
            continue;
        }
        const double *friction = g->contact->friction;
        const double mu = friction[0] / sqrt(IMPRATIO);
        const vd n = jar[0] * K(mu), s = jar[1] * K(friction[0]), t = jar[2] * K(friction[1]), length = root(s * s + t * t);
        const vi still = LANE_TRUE(length <= K(0.0));
        const vi apart = LANE_TRUE(n >= K(mu) * length) | (still & LANE_TRUE(n >= K(0.0)));
        const vi stuck = ~apart & (LANE_TRUE(K(mu) * n + length <= K(0.0)) | (still & LANE_TRUE(n < K(0.0))));
        const vd slide = -(n - K(mu) * length) * K(mu / (mu * mu * (1.0 + mu * mu))) / m->softness[i];
        const vd share = -slide / lane_select(still, K(1.0), length);
        const vi on_contact = g->active & ~apart;
        m->force[i] = lane_keep(on_contact, lane_select(stuck, -jar[0] / m->softness[i], slide));
        m->force[i + 1] = lane_keep(on_contact, lane_select(stuck, -jar[1] / m->softness[i + 1], share * s * K(friction[0])));
        m->force[i + 2] = lane_keep(on_contact, lane_select(stuck, -jar[2] / m->softness[i + 2], share * t * K(friction[1])));
    }
    vd cost = K(0.0);
    for (int r = 0; r < m->num_rows; r++) {
        vd sum = K(0.0);
        for (int s = 0; s < m->num_rows; s++)
            sum += m->a[r][s] * m->force[s];
        cost += m->force[r] * (K(0.5) * sum + m->residual[r]);
    }
    const vi worse = LANE_TRUE(cost > K(0.0));
    for (int r = 0; r < m->num_rows; r++)
        m->force[r] = lane_keep(~worse, m->force[r]);
}

/* Tangential forces x that minimise x' A x / 2 + b' x within the ellipse (x / friction)^2 <= most^2; by its dual. */
static void slide(vd a11, vd a12, vd a22, vd b1, vd b2, const double *friction, vd most, vi active, vd *x)
{
    const vd d1 = K(friction[0]), d2 = K(friction[1]), r2 = most * most;
    b1 *= d1;
    b2 *= d2;
    a11 *= d1 * d1;
    a22 *= d2 * d2;
    a12 *= d1 * d2;
    vd shift = K(0.0), v1 = K(0.0), v2 = K(0.0);
    vi running = active, singular = active & ~active;
    for (int k = 0; k < NEWTON; k++) {
        const vd p = a11 + shift, r = a22 + shift, det = p * r - a12 * a12;
        const vi bad = running & LANE_TRUE(det < K(NEGLIGIBLE));
        singular |= bad;
        running &= ~bad;
        const vd over = K(1.0) / det, p11 = r * over, p22 = p * over, p12 = -a12 * over;
        v1 = lane_select(running, -p11 * b1 - p12 * b2, v1);
        v2 = lane_select(running, -p12 * b1 - p22 * b2, v2);
        const vd beyond = v1 * v1 + v2 * v2 - r2;
        running &= ~LANE_TRUE(beyond < K(NEGLIGIBLE));
        if (!any(running))
            break;
        const vd slope = K(-2.0) * (p11 * v1 * v1 + K(2.0) * p12 * v1 * v2 + p22 * v2 * v2);
        const vd change = -beyond / slope;
        running &= ~LANE_TRUE(change < K(NEGLIGIBLE));
        shift += lane_keep(running, change);
        if (!any(running))
            break;
    }
    x[0] = lane_keep(~singular, v1 * d1);
    x[1] = lane_keep(~singular, v2 * d2);
    const vi bound = LANE_TRUE(shift != K(0.0)) & ~singular; /* onto the ellipse, which Newton's method may miss */
    if (any(bound)) {
        const vd s = x[0] / d1, t = x[1] / d2, scale = root(r2 / largest(K(TINY), s * s + t * t));
        x[0] = lane_select(bound, x[0] * scale, x[0]);
        x[1] = lane_select(bound, x[1] * scale, x[1]);
    }
}

/* One update of a group's forces in the running lanes; returns how much less the cost is. */
static vd update(struct memory *m, const struct group *g, vi running)
{
    const int i = g->first;
    vd *f = m->force + i, gradient[3], old[3], change = K(0.0);
    const vi active = g->active & running;
    for (int r = 0; r < g->size; r++) {
        gradient[r] = m->residual[i + r];
        old[r] = f[r];
    }
    if (g->contact) /* three sums at once: one alone would wait for each of its terms */
        for (int s = 0; s < m->num_rows; s++)
            for (int r = 0; r < 3; r++)
                gradient[r] += m->a[s][i + r] * m->force[s];
    else
        for (int s = 0; s < m->num_rows; s++)
            gradient[0] += m->a[s][i] * m->force[s];
    const vd single = largest(f[0] - gradient[0] / m->a[i][i], K(0.0));
    if (!g->contact) {
        const vd delta = single - old[0];
        change = K(0.5) * delta * delta * m->a[i][i] + delta * gradient[0];
        const vi taken = active & LANE_TRUE(change <= K(NEGLIGIBLE));
        f[0] = lane_select(taken, single, old[0]);
        return lane_keep(taken, -change);
    }
    const vi light = LANE_TRUE(f[0] < K(TINY));
    vd a[3][3], turned[3], next[3];
    for (int r = 0; r < 3; r++) {
        for (int s = 0; s < 3; s++)
            a[r][s] = m->a[i + r][i + s];
        turned[r] = dot(a[r], old);
    }
    /* along the force itself */
    const vd bend = dot(old, turned);
    vd x = lane_keep(LANE_TRUE(bend >= K(TINY)), -dot(old, gradient) / bend);
    x = lane_select(LANE_TRUE(old[0] + x * old[0] < K(0.0)), K(-1.0), x);
    next[0] = lane_select(light, single, old[0] + x * old[0]);
    next[1] = lane_keep(~light, old[1] + x * old[1]);
    next[2] = lane_keep(~light, old[2] + x * old[2]);
    const vi pressed = active & LANE_TRUE(next[0] >= K(TINY));
    if (any(pressed)) {
        vd b[2], tangent[2];
        for (int r = 0; r < 2; r++)
            b[r] = gradient[r + 1] - a[r + 1][1] * old[1] - a[r + 1][2] * old[2] + a[r + 1][0] * (next[0] - old[0]);
        slide(a[1][1], a[1][2], a[2][2], b[0], b[1], g->contact->friction, next[0], pressed, tangent);
        next[1] = lane_select(pressed, tangent[0], next[1]);
        next[2] = lane_select(pressed, tangent[1], next[2]);
    }
    vd delta[3];
    for (int r = 0; r < 3; r++)
        delta[r] = next[r] - old[r];
    for (int r = 0; r < 3; r++)
        change += delta[r] * (K(0.5) * dot(a[r], delta) + gradient[r]);
    const vi taken = active & LANE_TRUE(change <= K(NEGLIGIBLE));
    for (int r = 0; r < 3; r++)
        f[r] = lane_select(taken, next[r], old[r]);
    return lane_keep(taken, -change);
}

/* Add the change since the last sweep once more, by as much as each lane's momentum says, and come back into the cones. */
static void extrapolate(struct memory *m, vd share, vi on)
{
    for (int r = 0; r < m->num_rows; r++) {
        const vd now = m->force[r];
        m->force[r] = lane_select(on, now + share * (now - m->before[r]), now);
        m->before[r] = now;
    }
    if (!any(on))
        return;
    for (int k = 0; k < m->num_groups; k++) {
        const struct group *g = m->groups + k;
        vd *f = m->force + g->first;
        const vi pulls = LANE_TRUE(f[0] < K(0.0));
        for (int r = 0; r < g->size; r++)
            f[r] = lane_keep(~pulls, f[r]);
        if (!g->contact)
            continue;
        const double *mu = g->contact->friction;
        const vd most = f[0] * f[0], s = f[1] / K(mu[0]), t = f[2] / K(mu[1]), tangent = s * s + t * t;
        const vd scale = lane_select(on & LANE_TRUE(tangent > most), root(most / largest(tangent, K(TINY))), K(1.0));
        f[1] *= scale;
        f[2] *= scale;
    }
}

/* One update of every group, in the order that MuJoCo draws for as many as are active in a lane. */
static vd sweep(struct memory *m, int round, int (*active)[GROUPS + 1], const int *count, vi running)
{
    vd gained = K(0.0);
    for (int at = 0; at < m->num_groups; at++) {
        int next[PIAFFE_W], left = 0;
        for (int l = 0; l < PIAFFE_W; l++) {
            next[l] = at < count[l] ? active[l][order[round][count[l] * (count[l] - 1) / 2 + at]] : -1;
            left += next[l] >= 0;
        }
        for (int l = 0; left && l < PIAFFE_W; l++) {
            const int now = next[l];
            if (now < 0)
                continue;
            long long lanes[PIAFFE_W];
            vi mask;
            for (int o = 0; o < PIAFFE_W; o++) {
                lanes[o] = -(long long)(next[o] == now);
                if (next[o] == now) {
                    next[o] = -1;
                    left--;
                }
            }
            memcpy(&mask, lanes, sizeof mask);
            gained += update(m, m->groups + now, running & mask);
        }
    }
    return gained;
}

/* Projected Gauss-Seidel with momentum, which is lost where a sweep turns back. */
static void solve(struct memory *m)
{
    int active[PIAFFE_W][GROUPS + 1], count[PIAFFE_W] = {0};
    for (int k = 0; k < m->num_groups; k++)
        for (int l = 0; l < PIAFFE_W; l++)
            if (((const long long *)&m->groups[k].active)[l])
                active[l][count[l]++] = k;
    vi running = LANE_TRUE(K(0.0) == K(0.0));
    vd momentum = K(0.0);
    for (int k = 0; k < ITERATIONS && any(running); k++) {
        const vd share = (momentum - K(1.0)) / (momentum + K(2.0));
        extrapolate(m, share, k ? running & LANE_TRUE(share > K(0.0)) : running & ~running);
        memcpy(m->begun, m->force, sizeof(vd) * (size_t)m->num_rows);
        const vd gained = sweep(m, k, active, count, running);
        vd along = K(0.0);
        for (int r = 0; r < m->num_rows; r++)
            along += (m->force[r] - m->begun[r]) * (m->begun[r] - m->before[r]);
        momentum = lane_keep(~LANE_TRUE(along < K(0.0)), momentum + K(1.0));
        running &= ~LANE_TRUE(gained < K(ENOUGH));
    }
}

/* ---- a step */

static void step(struct memory *m)
{
    const vd norm = root(m->q[3] * m->q[3] + m->q[4] * m->q[4] + m->q[5] * m->q[5] + m->q[6] * m->q[6]);
    memcpy(m->unit, m->q, sizeof m->unit);
    for (int k = 3; k < 7; k++)
        m->unit[k] = m->q[k] / norm;
    const vd *arg[] = {m->unit, m->v, m->u};
    vd *res[] = {m->factor, m->inverse, m->acceleration, m->centre, m->moves};
    smooth(arg, res, m->work);
    m->num_groups = m->num_rows = 0;
    touch_limits(m);
    touch_ground(m);
    vd pushed[NV];
    for (int k = 0; k < NV; k++)
        pushed[k] = K(0.0);
    if (m->num_groups) {
        project(m);
        if (WARM)
            start(m);
        else
            for (int r = 0; r < m->num_rows; r++)
                m->force[r] = K(0.0);
        solve(m);
        for (int k = 0; k < m->num_groups; k++) {
            const struct group *g = m->groups + k;
            for (int r = g->first; r < g->first + g->size; r++)
                for (int a = 0; a < chain_size[g->dof]; a++)
                    pushed[chain[g->dof][a]] += m->half[r][a] * m->force[r];
        }
        for (int k = 0; k < NV; k++)
            pushed[k] *= m->inverse[k];
        for (int k = 0; k < NV; k++) {
            const vd *row = m->factor + factor_start[k];
            for (int a = 0; a < chain_size[k] - 1; a++)
                pushed[k] -= row[a] * pushed[chain[k][a]];
        }
    }
    for (int k = 0; k < NV; k++) {
        m->warm[k] = m->acceleration[k] + pushed[k];
        m->v[k] += K(STEP) * m->warm[k];
    }
    for (int k = 0; k < 3; k++)
        m->q[k] += K(STEP) * m->v[k];
    for (int k = 6; k < NV; k++)
        m->q[k + 1] += K(STEP) * m->v[k];
    const vd speed = root(dot(m->v + 3, m->v + 3));
    vd sine, cosine;
    lane_sincos(K(0.5 * STEP) * speed, &sine, &cosine);
    const vd over = sine / largest(speed, K(TINY));
    const vd w = m->unit[3], x = m->unit[4], y = m->unit[5], z = m->unit[6], a = m->v[3] * over, b = m->v[4] * over, c = m->v[5] * over;
    m->q[3] = w * cosine - x * a - y * b - z * c;
    m->q[4] = w * a + x * cosine + y * c - z * b;
    m->q[5] = w * b - x * c + y * cosine + z * a;
    m->q[6] = w * c + x * b - y * a + z * cosine;
}

/* ---- roll-outs */

static void write(const struct memory *m, double *to, long pitch, int count)
{
    for (int l = 0; l < count; l++) {
        double *own = to + l * pitch;
        for (int k = 0; k < NQ; k++)
            own[k] = ((const double *)(m->q + k))[l];
        for (int k = 0; k < NV; k++)
            own[NQ + k] = ((const double *)(m->v + k))[l];
    }
}

long piaffe_simulate_memory(void) { return (long)sizeof(struct memory); }

/* Samples first to last - 1 of n, whose S controls u[n][S][NU] hold for `substeps` steps each: states[n][S + 1][NX],
   whose first is set already. The first `lead` controls and the first state are the same for all samples, so that
   these are simulated once. `at` is memory of this thread, aligned to vd. */
void piaffe_simulate(const double *u, long steps, long substeps, long lead, long first, long last, double *states, void *at)
{
    struct memory *m = at;
    static const vd none[NV];
    vd q[NQ], v[NV], warm[NV];
    const long pitch = (steps + 1) * NX;
    memcpy(m->warm, none, sizeof none);
    if (lead) {
        const double *x = states + first * pitch;
        for (int k = 0; k < NQ; k++)
            m->q[k] = K(x[k]);
        for (int k = 0; k < NV; k++)
            m->v[k] = K(x[NQ + k]);
        for (long s = 0; s < lead; s++) {
            for (int k = 0; k < NU; k++)
                m->u[k] = K(u[(first * steps + s) * NU + k]);
            for (long k = 0; k < substeps; k++)
                step(m);
            write(m, states + first * pitch + (s + 1) * NX, pitch, 1);
        }
        for (long i = first + 1; i < last; i++)
            memcpy(states + i * pitch + NX, states + first * pitch + NX, sizeof(double) * (size_t)(lead * NX));
        memcpy(q, m->q, sizeof q);
        memcpy(v, m->v, sizeof v);
        memcpy(warm, m->warm, sizeof warm);
    }
    for (long i = first; i < last; i += PIAFFE_W) {
        const int count = last - i < PIAFFE_W ? (int)(last - i) : PIAFFE_W;
        if (lead) {
            memcpy(m->q, q, sizeof q);
            memcpy(m->v, v, sizeof v);
            memcpy(m->warm, warm, sizeof warm);
        } else {
            memcpy(m->warm, none, sizeof none);
            for (int l = 0; l < PIAFFE_W; l++) {
                const double *x = states + (i + (l < count ? l : 0)) * pitch;
                for (int k = 0; k < NQ; k++)
                    ((double *)(m->q + k))[l] = x[k];
                for (int k = 0; k < NV; k++)
                    ((double *)(m->v + k))[l] = x[NQ + k];
            }
        }
        for (long s = lead; s < steps; s++) {
            for (int l = 0; l < PIAFFE_W; l++) {
                const double *own = u + ((i + (l < count ? l : 0)) * steps + s) * NU;
                for (int k = 0; k < NU; k++)
                    ((double *)(m->u + k))[l] = own[k];
            }
            for (long k = 0; k < substeps; k++)
                step(m);
            write(m, states + i * pitch + (s + 1) * NX, pitch, count);
        }
    }
}
