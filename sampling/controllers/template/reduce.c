/* Reductions of violations. The violation of row i at step s in sample j is c[i * row + s * step + j]. */
#include <stddef.h>

#define BLOCK 64 /* samples at a time, so that the partial results are in registers */

/* largest[i]: largest violation of row i over all steps and samples; NaN counts as no violation, as in fmax */
void piaffe_maxima(const double *c, long rows, long row, long steps, long step, long n, double *largest)
{
    for (long i = 0; i < rows; i++) {
        double most[BLOCK] = {0.0}, all = 0.0;
        for (long s = 0; s < steps; s++) {
            const double *at = c + i * row + s * step;
            long j = 0;
            for (; j + BLOCK <= n; j += BLOCK)
                for (int l = 0; l < BLOCK; l++)
                    most[l] = at[j + l] > most[l] ? at[j + l] : most[l];
            for (; j < n; j++)
                all = at[j] > all ? at[j] : all;
        }
        for (int l = 0; l < BLOCK; l++)
            all = most[l] > all ? most[l] : all;
        largest[i] = all;
    }
}

/* delta[s * n + j] = max over i of min(c_isj slope_is, share_is), at least zero */
void piaffe_discount(const double *c, long rows, long row, long steps, long step, long n, const double *slope,
                     const double *share, double *restrict delta)
{
    for (long s = 0; s < steps; s++)
        for (long first = 0; first < n; first += BLOCK) {
            const int count = n - first < BLOCK ? (int)(n - first) : BLOCK;
            double most[BLOCK] = {0.0};
            for (long i = 0; i < rows; i++) {
                const double *at = c + i * row + s * step + first;
                const double by = slope[i * steps + s], top = share[i * steps + s];
                if (top <= 0.0)
                    continue;
                if (count == BLOCK)
                    for (int l = 0; l < BLOCK; l++) {
                        double d = at[l] * by;
                        d = d < top ? d : top;
                        most[l] = d > most[l] ? d : most[l];
                    }
                else
                    for (int l = 0; l < count; l++) {
                        double d = at[l] * by;
                        d = d < top ? d : top;
                        most[l] = d > most[l] ? d : most[l];
                    }
            }
            for (int l = 0; l < count; l++)
                delta[s * n + first + l] = most[l];
        }
}
