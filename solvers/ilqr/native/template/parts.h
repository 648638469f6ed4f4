/* The parts of an iteration as separate functions: for benchmarks, which time them, and for checks of memory. */
#ifndef PIAFFE_PARTS_H
#define PIAFFE_PARTS_H

struct Problem;

typedef struct {
    const char *name;
    void (*run)(struct Problem *problem);
} Part;

/* In the order of an iteration; the last entry has the name NULL. They need the linear-quadratic model of the accepted iterate,
 * which is available after a solve, and do not change this iterate. */
extern const Part piaffe_parts[];
#endif
