/* Data of a low level; low_level.py, vwbc.py and baselines.py are the same in NumPy, memory.py fills the memory. */
#ifndef PIAFFE_TICK_H
#define PIAFFE_TICK_H

#include "contacts.h"
#include "plan.h"

/* What a low level returns before gains and bounds: the control that minimises the action value, the plan's control with its
 * feedback, or the plan's control. */
enum law { ACTION_VALUE, FEEDBACK, FEEDFORWARD };

struct own_mode { /* what the low level has of a mode */
    const double *kept;    /* (ndx), 0 for components that do not count */
    const int *changed_at; /* (num_changed) places in p */
    int num_parameters, contact_at; /* np; place of the contact flags in p */
};

struct low_level {
    const struct plan *plan;
    const struct own_mode *modes;
    struct contacts *contacts; /* 0 if the schedule's hold */
    const double *changed;     /* (num_changed) parameters in place of the plan's */
    const double *kp, *kd;     /* (nu) */
    const double *limits;      /* (2, nu) lower and upper ones of the first stage, without rounding errors */
    const int *contact_of;     /* (nu) index of each control's contact flag, -1 for none */
    double *in_contact;        /* (num_contacts), of this tick */
    double in_stance, damping, gradient;
    int num_changed, new_masks, num_contacts, gains, law;
};

/* What a tick did; status is -1 if no program was made. excess: of soft rows. active: rows of the mode. */
struct outcome {
    int status, iterations, damped, mode, num_active;
    double excess;
    int *active;
    double *nominal, *recorded; /* if not 0: the plan's state (nx), what the model records of the control in the world */
};

typedef void (*tick_function)(const struct low_level *, const struct plan_phase *, int, double, const double *,
                              double *, struct outcome *);
#endif
