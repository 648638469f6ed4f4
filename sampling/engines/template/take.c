/* What MuJoCo's loop wrote, into states: of every sample the times and states after its steps, of which every n-th is
   the end of a control's. */
#include <string.h>

#define LANES 4 /* sums side by side: the compiler may not reorder one */

/* a number that is not one if a number among them is not finite */
static double oddness(const double *at, long count)
{
    double sums[LANES] = {0.0}, rest = 0.0;
    long k = 0;
    for (; k + LANES <= count; k += LANES)
        for (int l = 0; l < LANES; l++)
            sums[l] += at[k + l] - at[k + l];
    for (; k < count; k++)
        rest += at[k] - at[k];
    return rest + ((sums[0] + sums[1]) + (sums[2] + sums[3]));
}

static double squares(const double *at, long count)
{
    double sums[LANES] = {0.0}, rest = 0.0;
    long k = 0;
    for (; k + LANES <= count; k += LANES)
        for (int l = 0; l < LANES; l++)
            sums[l] += at[k + l] * at[k + l];
    for (; k < count; k++)
        rest += at[k] * at[k];
    return rest + ((sums[0] + sums[1]) + (sums[2] + sums[3]));
}

/* simulated: n samples of steps * every rows (time, nq positions, nv speeds); states: the first of those to write, its
   samples a pitch apart. A sample is suspect if its last time is not beyond due, a position is not finite, or its
   speeds of all steps together are above the limit of one. */
void piaffe_take(const double *simulated, long n, long steps, long every, long nq, long nv, double due, double limit,
                 double *states, long pitch, unsigned char *suspect)
{
    const long nx = nq + nv, row = 1 + nx;
    for (long i = 0; i < n; i++) {
        const double *from = simulated + i * steps * every * row;
        double odd = 0.0, energy = 0.0;
        for (long s = 0; s < steps; s++) {
            const double *x = from + ((s + 1) * every - 1) * row + 1;
            memcpy(states + i * pitch + s * nx, x, sizeof(double) * (size_t)nx);
            odd += oddness(x, nq);
            energy += squares(x + nq, nv);
        }
        suspect[i] = !(odd == 0.0 && energy <= limit * limit && from[(steps * every - 1) * row] > due);
    }
}

/* for MuJoCo to ask in place of its clock */
double piaffe_no_time(void) { return 0.0; }
