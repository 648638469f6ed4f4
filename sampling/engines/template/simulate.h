/* Common parts of the simulation's files: the scene, the memory of a thread, and small functions of vectors. A vd
   contains one number for each of PIAFFE_W samples. */
#ifndef PIAFFE_SIMULATE_H
#define PIAFFE_SIMULATE_H
#include <string.h>

#include "functions.h"

#define TINY 1e-15       /* MuJoCo's mjMINVAL */
#define NEGLIGIBLE 1e-10 /* an update that increases the cost by more is undone; also the tolerance of Newton's method for a friction force */

struct soft { double stiffness, damping, start, end, width, middle, power, inverse_mass; };
struct ground { int box; double place[3], axes[3][3], half[3]; };
struct contact { int ball, ground; double friction[2]; struct soft soft; };
struct limit { int dof; double lower, upper; struct soft soft; };

#include "scene.h"

#define GROUPS (LIMITS + CONTACTS)
#define ROWS (LIMITS + 3 * CONTACTS + 1)
#define NX (NQ + NV)

/* the rows of one limit or contact */
struct group {
    int first, size, dof; /* rows; the degree of freedom whose chain the rows are over */
    vi active;
    const struct contact *contact; /* null for a limit */
};

struct memory {
    vd q[NQ], v[NV], warm[NV], u[NU];                                                  /* state, warm start and control */
    vd unit[NQ], factor[FACTORS], inverse[NV], acceleration[NV], centre[3 * BALLS + 1], moves[MOVES + 1];
    vd jacobian[ROWS][CHAIN], half[ROWS][CHAIN], scaled[ROWS][CHAIN];                  /* J, J L^-1, J L^-1 D^-1 */
    vd softness[ROWS], reference[ROWS], residual[ROWS], force[ROWS], a[ROWS][ROWS];    /* R, a_ref, b, f, J M^-1 J' + R */
    vd before[ROWS], begun[ROWS];                                                      /* f before the last sweep and at the start of this one */
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
#endif
