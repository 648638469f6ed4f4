/* The parts of an iteration, each to be run by itself: for benchmarks, which time them, and for checks of memory. */
#ifndef PIAFFE_PARTS_H
#define PIAFFE_PARTS_H

struct Problem;

typedef struct {
    const char *name;
    void (*run)(struct Problem *problem);
} Part;

/* In the order of an iteration; a name of NULL follows the last. They need the linear-quadratic model of the accepted iterate,
 * which a solve leaves behind, and do not change that iterate. */
extern const Part piaffe_parts[];
#endif
