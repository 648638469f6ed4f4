/* A tick: the stage of the plan at a time, then the program of its mode. It allocates nothing. */
#include "tick.h"

#define SAME_TIME 1e-7

TICK_PROTOTYPES
static const tick_function of_mode[] = {TICK_FUNCTIONS};

void piaffe_tick(const struct low_level *low, const double *x, double t, double *control, struct outcome *out)
{
    int i = 0, k = 0;
    for (int j = 0; j < low->num_phases; j++)
        if (low->phases[j].times[0] <= t + SAME_TIME) i = j;
    const struct phase *f = low->phases + i;
    while (k < f->stages - 1 && f->times[k + 1] <= t + SAME_TIME) k++;
    double share = (t - f->times[k]) / (f->times[k + 1] - f->times[k]);
    out->mode = f->mode;
    of_mode[f->mode](low, f, k, fmin(fmax(share, 0.0), 1.0), x, control, out);
}
