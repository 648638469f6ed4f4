/* Evaluates a function with SIMD over samples: for each step, it copies the shared inputs once, then evaluates PIAFFE_W
   samples at a time. */
#include <string.h>

#include "run.h"

/* number k of the sample in lane l: row[l][k] */
static void gather(const struct input *in, long step, long first, int count, vd *restrict to)
{
    const double *row[PIAFFE_W];
    for (int l = 0; l < PIAFFE_W; l++)
        row[l] = in->data + step * in->step + (first + (l < count ? l : 0)) * in->sample;
    for (int k = 0; k < in->size; k++)
        for (int l = 0; l < PIAFFE_W; l++)
            ((double *)(to + k))[l] = row[l][k];
}

static void splat(const struct input *in, long step, vd *restrict to)
{
    const double *row = in->data + step * in->step;
    for (int k = 0; k < in->size; k++)
        to[k] = K(row[k]);
}

static void scatter(const struct output *out, long step, long first, int count, const vd *restrict from)
{
    double *to = out->data + step * out->step + first * out->sample;
    for (int i = 0; i < out->size; i++) {
        const double *lane = (const double *)(from + i);
        double *own = to + i * out->row;
        if (out->sample == 1 && count == PIAFFE_W)
            memcpy(own, lane, sizeof(vd));
        else
            for (int l = 0; l < count; l++)
                own[l * out->sample] = lane[l];
    }
}

void run(function f, int num_in, const struct input *in, int num_out, const struct output *out, long steps, long first,
         long last, double *memory)
{
    const vd *arg[MAX_ARGUMENTS];
    vd *res[MAX_ARGUMENTS], *to[MAX_ARGUMENTS], *at = (vd *)memory;
    for (int i = 0; i < num_in; i++) {
        arg[i] = to[i] = at;
        at += in[i].size;
    }
    for (int i = 0; i < num_out; i++) {
        res[i] = at;
        at += out[i].size;
    }
    for (long step = 0; step < steps; step++) {
        for (int i = 0; i < num_in; i++)
            if (in[i].shared)
                splat(in + i, step, to[i]);
        for (long sample = first; sample < last; sample += PIAFFE_W) {
            const int count = last - sample < PIAFFE_W ? (int)(last - sample) : PIAFFE_W;
            for (int i = 0; i < num_in; i++)
                if (!in[i].shared)
                    gather(in + i, step, sample, count, to[i]);
            f(arg, res, at);
            for (int i = 0; i < num_out; i++)
                scatter(out + i, step, sample, count, res[i]);
        }
    }
}
