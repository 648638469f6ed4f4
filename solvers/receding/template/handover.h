/* A handover of things, such as plans, from a thread that makes them to a thread that uses them. Neither ever waits for the other.
 *
 * There are four places. The writer has `back`, the reader `acting` and `next`; the one in the middle belongs to nobody. To hand over
 * and to receive are each one exchange with the middle, so a place has one owner at a time, and the newest complete thing wins. The
 * place that was handed over last is not the writer's next one, so the writer may still read it. */
#ifndef PIAFFE_HANDOVER_H
#define PIAFFE_HANDOVER_H

#include <stdatomic.h>

enum { PLACES = 4, FRESH = 4 };

struct handover {
    _Atomic unsigned middle; /* a place, and FRESH if the reader has not seen it */
    unsigned back;           /* of the writer */
    unsigned acting, next;   /* of the reader */
};

static inline void handover_init(struct handover *h)
{
    atomic_init(&h->middle, 0u);
    h->back = 1, h->acting = 2, h->next = 3;
}

/* Writer: what is in `back` is complete; afterwards `back` is another place. */
static inline void hand_over(struct handover *h)
{
    h->back = atomic_exchange_explicit(&h->middle, h->back | FRESH, memory_order_acq_rel) & ~(unsigned)FRESH;
}

/* Reader: returns 1 if there is something new; it is in `next` then. */
static inline int receive(struct handover *h)
{
    if (!(atomic_load_explicit(&h->middle, memory_order_relaxed) & FRESH)) return 0;
    h->next = atomic_exchange_explicit(&h->middle, h->next, memory_order_acq_rel) & ~(unsigned)FRESH;
    return 1;
}

/* Reader: what is in `next` is used from now on. */
static inline void use_next(struct handover *h)
{
    unsigned before = h->acting;
    h->acting = h->next, h->next = before;
}
#endif
