/* Evaluation of functions with SIMD over samples, for many steps. */
#ifndef PIAFFE_RUN_H
#define PIAFFE_RUN_H

#include "simd.h"

#define MAX_ARGUMENTS 8

typedef void (*function)(const vd *const *arg, vd *const *res, vd *w);

/* number k of sample i at step s: data[i * sample + s * step + k]; if shared, the same for all samples */
struct input {
    const double *data;
    long sample, step;
    int size, shared;
};

/* row r of sample i at step s: data[r * row + s * step + i * sample] */
struct output {
    double *data;
    long row, step, sample;
    int size;
};

/* Evaluates samples first to last - 1 at all steps. memory is aligned to vd and has the size of inputs, outputs and
   work together. */
void run(function f, int num_in, const struct input *in, int num_out, const struct output *out, long steps, long first,
         long last, double *memory);

#endif
