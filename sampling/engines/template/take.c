/* Copies the results of MuJoCo's loop, times and states after each step of the simulator, to an array with the states
   at the end of each control. */
#include <string.h>

#define LANES 4 /* parallel sums, because the compiler may not change the order of a single sum */

/* 0 if all numbers are finite, else NaN */
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
   samples `pitch` apart. A sample is suspect if its last time is not beyond `due`, a position is not finite, or the norm
   of the velocities of all its steps is above `limit`, the limit of one velocity. */
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

/* MuJoCo calls this function instead of its clock */
double piaffe_no_time(void) { return 0.0; }
