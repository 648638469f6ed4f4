/* A writer and a reader hand over thousands of numbered, checksummed arrays; returns how often something was wrong. */
#include <pthread.h>
#include <stdint.h>
#include <string.h>

#include "handover.h"

enum { WORDS = 512 };

struct place {
    uint64_t number, sum, words[WORDS];
};

struct stress {
    struct handover plans;
    struct place places[PLACES];
    uint64_t count;
    long writer_faults, seen;
};

static uint64_t sum_of(const struct place *p)
{
    uint64_t sum = p->number * 0x9e3779b97f4a7c15u;
    for (int i = 0; i < WORDS; i++) sum = (sum ^ p->words[i]) * 0x100000001b3u;
    return sum;
}

static void *write_all(void *argument)
{
    struct stress *s = argument;
    const struct place *last = 0;
    for (uint64_t n = 1; n <= s->count; n++) {
        struct place *p = &s->places[s->plans.back];
        if (p == last) s->writer_faults++; /* the planner reads its last plan while it writes the next */
        p->number = n;
        for (int i = 0; i < WORDS; i++) p->words[i] = n * 2654435761u + (uint64_t)i * n;
        if (last && (last->number != n - 1 || last->sum != sum_of(last))) s->writer_faults++;
        p->sum = sum_of(p);
        last = p;
        hand_over(&s->plans);
    }
    return 0;
}

long stress(uint64_t count, long *seen)
{
    static struct stress s;
    pthread_t writer;
    long faults = 0;
    uint64_t before = 0;
    memset(&s, 0, sizeof s);
    handover_init(&s.plans);
    s.count = count;
    if (pthread_create(&writer, 0, write_all, &s)) return -1;
    while (before < count) {
        const struct place *acting = &s.places[s.plans.acting];
        if (before && (acting->number != before || acting->sum != sum_of(acting))) faults++; /* nobody writes there */
        if (!receive(&s.plans)) continue;
        const struct place *next = &s.places[s.plans.next];
        if (next->number <= before || next->sum != sum_of(next)) faults++;
        if (acting->number != before) faults++; /* the one that is used stays while another waits */
        before = next->number;
        s.seen++;
        use_next(&s.plans);
    }
    pthread_join(writer, 0);
    *seen = s.seen;
    return faults + s.writer_faults;
}

#ifdef WITH_MAIN
#include <stdio.h>
int main(void)
{
    long seen, faults = stress(200000, &seen);
    printf("%ld faults, %ld of 200000 seen\n", faults, seen);
    return faults != 0;
}
#endif
