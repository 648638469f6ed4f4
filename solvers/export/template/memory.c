/* The tables of the motion, and the first values of a controller's memory. */
#include "memory.h"

#include <math.h>
#include <string.h>

#include "horizon/functions.h"

@EXTERNS@
@CONSTANTS@
void piaffe_fill(struct memory *m)
{
@FILLING@}

/* Bytes of the solver's memory for the longest horizon that begins at one of some ticks. */
static size_t most_bytes(const Horizon *horizon, long first, long last, long step)
{
    Span spans[@SPANS@];
    Node nodes[@NODES@];
    int firsts[@SPANS@];
    Problem problem = {0};
    Receding r = {.horizon = horizon, .spans = spans, .nodes = nodes, .firsts = firsts, .problem = &problem};
    size_t most = 0;
    for (long k = first; k < last; k += step) {
        size_t bytes;
        long numbers, entries;
        receding_sizes(&r, k, &bytes, &numbers, &entries);
        if (bytes > most) most = bytes;
    }
    return most;
}

static size_t larger(size_t a, size_t b) { return a > b ? a : b; }

size_t piaffe_arena_bytes(void)
{
    size_t most = 0;
@HORIZONS@    return most;
}
