/* Least seconds of each part of an iteration, for common.py. The parts run in turn, so that each finds the caches as the one
 * before it leaves them. */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <time.h>

#include "parts.h"

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

void profile(const Part *parts, int count, struct Problem *problem, int repetitions, double *seconds)
{
    for (int i = 0; i < count; i++) seconds[i] = INFINITY;
    for (int r = 0; r < repetitions; r++)
        for (int i = 0; i < count; i++) {
            double began = now();
            parts[i].run(problem);
            seconds[i] = fmin(seconds[i], now() - began);
        }
}
