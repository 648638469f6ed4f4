/* A tick: the stage of the plan at a time, its contacts, then the program of its mode. It allocates nothing. */
#include <math.h>
#include <string.h>

#include "dual.c"
#include "elastic.inc"
#include "functions.h"
#include "tick.h"

#define SAME_LIMIT 1e-12

/* A limit, or the given one if they differ by rounding: so torques are within the very numbers that are declared. */
static inline double same_limit(double limit, double given) { return fabs(limit - given) <= SAME_LIMIT * fabs(given) ? given : limit; }

TICK_PROTOTYPES
static const tick_function of_mode[] = {TICK_FUNCTIONS};

static const double *flags_of(const struct low_level *low, const struct plan_phase *f, int k)
{
    const struct own_mode *mode = low->modes + f->mode;
    return f->p + (long)k * mode->num_parameters + mode->contact_at;
}

/* The plan's flags at a stage, and those of the stages after it that begin until a time. */
static void read_schedule(const struct low_level *low, int i, int k, double until)
{
    struct contacts *c = low->contacts;
    memcpy(c->scheduled, flags_of(low, low->plan->phases + i, k), sizeof(double) * (size_t)low->num_contacts);
    for (int n = 0; n < low->num_contacts; n++) c->soon[n] = 0.0;
    for (k++; i < low->plan->num_phases; i++, k = 0)
        for (; k < low->plan->phases[i].stages && low->plan->phases[i].times[k] <= until + SAME_TIME; k++) {
            const double *flags = flags_of(low, low->plan->phases + i, k);
            for (int n = 0; n < low->num_contacts; n++) c->soon[n] = fmax(c->soon[n], flags[n]);
        }
}

/* The phase at a time, and its stage. */
static int phase_at(const struct plan *plan, double t, int *stage)
{
    int i = 0, k = 0;
    for (int j = 0; j < plan->num_phases; j++)
        if (plan->phases[j].times[0] <= t + SAME_TIME) i = j;
    const struct plan_phase *f = plan->phases + i;
    while (k < f->stages - 1 && f->times[k + 1] <= t + SAME_TIME) k++;
    *stage = k;
    return i;
}

/* The flags of the plan that is followed, at any time. */
void piaffe_scheduled(const struct low_level *low, double t, double *flags)
{
    int k, i = phase_at(low->plan, t, &k);
    memcpy(flags, flags_of(low, low->plan->phases + i, k), sizeof(double) * (size_t)low->num_contacts);
}

void piaffe_tick(const struct low_level *low, const double *x, double t, double *control, struct outcome *out)
{
    int k, i = phase_at(low->plan, t, &k);
    const struct plan_phase *f = low->plan->phases + i;
    if (low->contacts) {
        read_schedule(low, i, k, t + low->contacts->early);
        merge_contacts(low->contacts, low->num_contacts, t, low->in_contact);
    }
    double share = (t - f->times[k]) / (f->times[k + 1] - f->times[k]);
    out->mode = f->mode;
    of_mode[f->mode](low, f, k, fmin(fmax(share, 0.0), 1.0), x, control, out);
}
