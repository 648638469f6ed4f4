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

size_t piaffe_arena_bytes(void)
{
    static const Horizon horizon = @HORIZON@;
    Span spans[@SPANS@];
    Node nodes[@NODES@];
    int firsts[@SPANS@];
    Problem problem = {0};
    Receding r = {.horizon = &horizon, .spans = spans, .nodes = nodes, .firsts = firsts, .problem = &problem};
    size_t most = 0;
    const long first = @FIRST@, last = @LAST@, step = @STEP@;
    for (long k = first; k < last; k += step) {
        size_t bytes;
        long numbers, entries;
        receding_sizes(&r, k, &bytes, &numbers, &entries);
        if (bytes > most) most = bytes;
    }
    return most;
}
