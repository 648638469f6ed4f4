/* Which points count as in contact: measured flags, debounced and merged with the schedule. contacts.py is the same in
 * NumPy and describes the rule. */
#ifndef PIAFFE_CONTACTS_H
#define PIAFFE_CONTACTS_H

#include <math.h>

#include "constants.h"

struct contacts { /* arrays have an entry per flag */
    double last, debounce, leave, early, late; /* last: time of the last tick, infinite before the first [s] */
    const double *measured;
    double *scheduled, *soon;    /* of the plan at this time, and within `early` */
    double *on, *before;         /* whether the point touches; the plan's flag in the last tick */
    double *since, *due;         /* time of the first reading that differs, of the awaited touchdown; NaN for none */
};

static inline void merge_contacts(struct contacts *c, int num, double t, double *in_contact)
{
    int fresh = t < c->last - SAME_TIME;
    c->last = t;
    for (int i = 0; i < num; i++) {
        double plan = c->scheduled[i] > 0.5, read = c->measured[i] > 0.5;
        if (fresh) c->on[i] = c->before[i] = plan, c->since[i] = c->due[i] = NAN;
        if (plan != c->before[i]) {
            c->before[i] = plan;
            if (plan > 0.0) c->due[i] = t;
            else c->on[i] = 0.0, c->since[i] = c->due[i] = NAN;
        }
        if (read == c->on[i]) c->since[i] = NAN;
        else {
            if (isnan(c->since[i])) c->since[i] = t;
            if (t - c->since[i] >= (plan > read ? c->leave : c->debounce) - SAME_TIME) c->on[i] = read, c->since[i] = NAN;
        }
        if (t - c->due[i] >= c->late - SAME_TIME) c->on[i] = 1.0, c->since[i] = NAN;
        if (c->on[i] > 0.0) c->due[i] = NAN;
        in_contact[i] = c->on[i] > 0.0 && (plan > 0.0 || c->soon[i] > 0.5) ? 1.0 : 0.0;
    }
}
#endif
