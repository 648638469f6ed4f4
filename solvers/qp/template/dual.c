/* The dual active-set method of Goldfarb and Idnani (1983) for a small, strictly convex quadratic program:
 *
 *     minimise 1/2 x'H x + g'x   subject to   A x = b,   C x >= d.
 *
 * It allocates nothing, and its work is bounded by PIAFFE_QP_LIMIT iterations; dual.py is the same method in NumPy.
 *
 * The iterate minimises the objective over the active rows, so it is dual feasible. A step adds the row that is violated
 * most. If the multiplier of an active row reaches zero on the way, that row is dropped and the step continues.
 * With N the active rows as columns, J'H J = I and J'N = (R; 0): the columns of J from q on span their null space.
 */
#include <math.h>

#define PIAFFE_QP_LIMIT 200
#define TOLERANCE 1e-9  /* of a row's distance, relative to the numbers in it */
#define DEPENDENT 1e-20 /* squared sine below which a row depends on the active ones */
#define SMALL 1e-14     /* a row's share of the step below which its multiplier does not change */

enum { SOLVED, INFEASIBLE, NOT_CONVEX, NOT_FINITE, ITERATION_LIMIT };

static double dot(const double *a, const double *b, int n)
{
    double sum = 0.0;
    for (int i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

/* Rotate columns k and k + 1 of J (n, n). */
static void rotate(double *J, int n, int k, double c, double s)
{
    for (int i = 0; i < n; i++) {
        double a = J[i * n + k], b = J[i * n + k + 1];
        J[i * n + k] = c * a + s * b;
        J[i * n + k + 1] = c * b - s * a;
    }
}

/* J = L^-T with H = L L'; 0 if H is positive definite. J is upper triangular. */
static int factorise(const double *H, double *L, double *J, int n)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            double v = H[i * n + j] - dot(L + i * n, L + j * n, j);
            if (i != j) {
                L[i * n + j] = v / L[j * n + j];
                continue;
            }
            if (!isfinite(v)) return NOT_FINITE;
            if (!(v > 0.0)) return NOT_CONVEX;
            L[i * n + i] = sqrt(v);
        }
    for (int c = 0; c < n; c++)
        for (int i = 0; i < n; i++) {
            double v = i == c ? 1.0 : 0.0;
            for (int k = c; k < i; k++) v -= L[i * n + k] * J[c * n + k];
            J[c * n + i] = i < c ? 0.0 : v / L[i * n + i];
        }
    return SOLVED;
}

/* Solve the program.
 *
 * n, equalities, rows: sizes.  H (n, n), of which the lower triangle is read, g (n), A (equalities, n), b (equalities),
 * C (rows, n), d (rows); d = -inf is no row.  x (n), multipliers (equalities + rows): H x + g = [A; C]' multipliers.
 * active (rows): in: rows that are tried first, out: the active rows.  counts: iterations, active rows.
 * work: n (2 n + 5) + 3 (equalities + rows) doubles.  places: n + equalities + 2 rows integers. */
int piaffe_qp(int n, int equalities, int rows, const double *H, const double *g, const double *A, const double *b,
              const double *C, const double *d, double *x, double *multipliers, int *active, int *counts, double *work,
              int *places)
{
    int all = equalities + rows, q = 0, fixed = 0, iterations = 0, status;
    double *J = work, *R = J + n * n, *w = R + n * n, *z = w + n, *r = z + n, *u = r + n, *e = u + n;
    double *size = e + n, *level = size + all, *slack = level + all;
    int *index = places, *in = index + n, *first = in + all;
    counts[0] = counts[1] = 0;
    for (int i = 0; i < all; i++) {
        const double *row = i < equalities ? A + i * n : C + (i - equalities) * n;
        double to = i < equalities ? b[i] : d[i - equalities], norm = sqrt(dot(row, row, n));
        if (!isfinite(norm) || isnan(to) || (isinf(to) && (to > 0.0 || i < equalities))) return NOT_FINITE;
        size[i] = norm > 0.0 ? norm : 1.0;
        level[i] = to / size[i];
        in[i] = 0;
        multipliers[i] = 0.0;
    }
    for (int i = 0; i < rows; i++) first[i] = active[i] != 0, active[i] = 0;
    if ((status = factorise(H, R, J, n)) != SOLVED) return status;
    for (int i = 0; i < n; i++) {
        w[i] = 0.0;
        for (int k = 0; k <= i; k++) w[i] += J[k * n + i] * g[k];
    }
    for (int i = 0; i < n; i++) {
        x[i] = -dot(J + i * n + i, w + i, n - i);
        if (!isfinite(x[i])) return NOT_FINITE;
    }
    for (int next = 0;;) {
        double largest = 0.0, worst = 0.0;
        int p = -1, preferred = 0;
        for (int i = 0; i < n; i++) largest = fmax(largest, fabs(x[i]));
        if (next < equalities) {
            p = next++;
            slack[p] = dot(A + p * n, x, n) / size[p] - level[p];
        } else
            for (int i = equalities; i < all; i++) {
                if (in[i]) continue;
                int k = i - equalities;
                slack[i] = dot(C + k * n, x, n) / size[i] - level[i];
                if (slack[i] >= -TOLERANCE * (1.0 + largest + fabs(level[i]))) continue;
                if (p >= 0 && (first[k] < preferred || (first[k] == preferred && slack[i] >= worst))) continue;
                p = i, worst = slack[i], preferred = first[k];
            }
        if (p < 0) break;
        const double *row = p < equalities ? A + p * n : C + (p - equalities) * n;
        double added = 0.0;
        for (;;) {
            double whole = 0.0, free = 0.0, most = 0.0, to_drop = INFINITY, to_add = INFINITY;
            int drop = -1;
            if (++iterations > PIAFFE_QP_LIMIT) {
                counts[0] = PIAFFE_QP_LIMIT;
                return ITERATION_LIMIT;
            }
            for (int k = 0; k < n; k++) w[k] = 0.0;
            for (int i = 0; i < n; i++)
                for (int k = 0; k < n; k++) w[k] += J[i * n + k] * (row[i] / size[p]);
            for (int i = 0; i < n; i++) z[i] = dot(J + i * n + q, w + q, n - q);
            for (int i = q - 1; i >= 0; i--) {
                double v = w[i];
                for (int k = i + 1; k < q; k++) v -= R[i * n + k] * r[k];
                r[i] = v / R[i * n + i];
            }
            for (int i = fixed; i < q; i++) most = fmax(most, fabs(r[i]));
            for (int i = fixed; i < q; i++)
                if (r[i] > SMALL * most && u[i] / r[i] < to_drop) to_drop = u[i] / r[i], drop = i;
            for (int i = 0; i < n; i++) {
                whole += w[i] * w[i];
                if (i >= q) free += w[i] * w[i];
            }
            if (free > DEPENDENT * whole) to_add = -slack[p] / free;
            double step = to_add < to_drop ? to_add : to_drop;
            if (!(step < INFINITY)) {
                /* an equality that follows from the others has no effect */
                if (p < equalities && fabs(slack[p]) <= TOLERANCE * (1.0 + largest + fabs(level[p]))) break;
                counts[0] = iterations;
                return isnan(step) ? NOT_FINITE : INFEASIBLE;
            }
            for (int i = 0; i < q; i++) u[i] -= step * r[i];
            added += step;
            if (to_add < INFINITY) {
                for (int i = 0; i < n; i++) x[i] += step * z[i];
                slack[p] += step * free;
            }
            if (step == to_add) { /* add p: rotate w[q + 1..] into w[q] */
                for (int k = n - 2; k >= q; k--) {
                    if (w[k + 1] == 0.0) continue;
                    double h = hypot(w[k], w[k + 1]);
                    rotate(J, n, k, w[k] / h, w[k + 1] / h);
                    w[k] = h;
                }
                for (int i = 0; i <= q; i++) R[i * n + q] = w[i];
                index[q] = p, u[q++] = added, in[p] = 1;
                if (p < equalities) fixed = q;
                break;
            }
            in[index[drop]] = 0; /* drop a row: remove its column of R, and restore the triangle */
            for (int k = drop; k < q - 1; k++) {
                index[k] = index[k + 1], u[k] = u[k + 1];
                for (int i = 0; i <= k + 1; i++) R[i * n + k] = R[i * n + k + 1];
            }
            q--;
            for (int k = drop; k < q; k++) {
                double a = R[k * n + k], c = R[(k + 1) * n + k], h = hypot(a, c);
                if (c == 0.0) continue;
                a /= h, c /= h;
                for (int j = k; j < q; j++) {
                    double up = R[k * n + j], low = R[(k + 1) * n + j];
                    R[k * n + j] = a * up + c * low;
                    R[(k + 1) * n + j] = a * low - c * up;
                }
                rotate(J, n, k, a, c);
            }
        }
    }
    /* One step of Newton's method on the active rows removes the rounding errors of the updates. */
    for (int i = 0; i < n; i++) {
        e[i] = -g[i];
        for (int k = 0; k < n; k++) e[i] -= H[k <= i ? i * n + k : k * n + i] * x[k];
        for (int k = 0; k < q; k++) {
            int p = index[k];
            e[i] += (p < equalities ? A + p * n : C + (p - equalities) * n)[i] / size[p] * u[k];
        }
    }
    for (int k = 0; k < n; k++) {
        w[k] = 0.0;
        for (int i = 0; i < n; i++) w[k] += J[i * n + k] * e[i];
    }
    for (int k = 0; k < q; k++) { /* z: J'(the change of x) */
        int p = index[k];
        const double *row = p < equalities ? A + p * n : C + (p - equalities) * n;
        double v = level[p] - dot(row, x, n) / size[p];
        for (int i = 0; i < k; i++) v -= R[i * n + k] * z[i];
        z[k] = v / R[k * n + k];
    }
    for (int k = q; k < n; k++) z[k] = w[k];
    for (int i = q - 1; i >= 0; i--) {
        double v = z[i] - w[i];
        for (int k = i + 1; k < q; k++) v -= R[i * n + k] * r[k];
        r[i] = v / R[i * n + i];
        u[i] += r[i];
    }
    for (int i = 0; i < n; i++) x[i] += dot(J + i * n, z, n);
    for (int k = 0; k < q; k++) {
        int p = index[k];
        multipliers[p] = (p < equalities ? u[k] : fmax(u[k], 0.0)) / size[p];
        if (p >= equalities) active[p - equalities] = 1;
    }
    counts[0] = iterations, counts[1] = q;
    return SOLVED;
}
