/* MuJoCo's step of a legged robot, PIAFFE_W samples at a time: smooth dynamics, limits of joints and contacts of balls
   with planes and boxes, solved by projected Gauss-Seidel with elliptic cones, then Euler's step.

   Formulas and their order are those of MuJoCo 4.0, so states agree with MuJoCo's up to rounding. A constraint is
   computed if it is active in one of the samples; in the others its force is zero. This file contains the roll-outs.
   The files that it includes are compiled with it, as one unit. */
#include "simulate.h"

#include "contacts.inc"
#include "constraints.inc"
#include "gauss_seidel.inc"
#include "step.inc"

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

/* Simulates samples first to last - 1 of n. Each of the S controls u[n][S][NU] is constant for `substeps` steps. The
   first state of each sample in states[n][S + 1][NX] is an input, the others are outputs. If `lead` is positive, the
   first state and the first `lead` controls are the same for all samples, and these steps are simulated once. `at` is
   memory of this thread, aligned to vd. */
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
