/* The memory of a controller: what the planner and the low level read and write. */
#ifndef PIAFFE_MEMORY_H
#define PIAFFE_MEMORY_H

#include "horizon/motions.h"
#include "tick/tick.h"

struct memory {
@MEMBERS@};

/* Writes the first values into memory whose bytes are zero. */
void piaffe_fill(struct memory *m);
/* Bytes of the solver's memory for the longest horizon. */
size_t piaffe_arena_bytes(void);
#endif
