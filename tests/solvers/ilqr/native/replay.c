/* Read a machine's memory from a file, every array by itself and exactly as large as it is said to be; solve; tell the history.
 * Arrays without content begin as NaN, or, under memcheck (-DUNDEFINED), as what malloc gives. */
#define _GNU_SOURCE
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "parts.h"
#include "piaffe.h"

extern const void *const tables[]; /* of modes, then of transitions */

static long long number(FILE *file)
{
    long long n;
    if (fread(&n, sizeof n, 1, file) != 1) abort();
    return n;
}

int main(int count, char **names)
{
    for (int image = 1; image < count; image++) {
        FILE *file = fopen(names[image], "rb");
        if (!file) return 2;
        long long blocks = number(file);
        char **memory = malloc(sizeof(char *) * (size_t)blocks);
        for (long long b = 0; b < blocks; b++) {
            size_t size = (size_t)number(file);
            if (posix_memalign((void **)&memory[b], 64, size)) return 2;
            if (number(file)) {
                if (size && fread(memory[b], 1, size, file) != size) return 2;
            } else {
#ifndef UNDEFINED
                memset(memory[b], 0xff, size);
#endif
            }
        }
        for (long long pointers = number(file); pointers > 0; pointers--) {
            long long from = number(file), at = number(file), to = number(file), offset = number(file);
            char *target = memory[to] + offset;
            memcpy(memory[from] + at, &target, sizeof target);
        }
        for (long long pointers = number(file); pointers > 0; pointers--) {
            long long from = number(file), at = number(file), table = number(file);
            memcpy(memory[from] + at, &tables[table], sizeof tables[table]);
        }
        Problem *problem = (Problem *)memory[number(file)];
        int resumed = (int)number(file);
        fclose(file);
        int status = piaffe_solve(problem, resumed);
        printf("%d %d %.17g\n", status, problem->num_records, piaffe_merit(problem));
        for (int k = 0; k < problem->num_records; k++) printf("%.17g\n", problem->history[k].cost);
        piaffe_policy(problem);
        for (int turn = 0; turn < 2; turn++)
            for (const Part *part = piaffe_parts; part->name; part++) part->run(problem);
        for (long long b = 0; b < blocks; b++) free(memory[b]);
        free(memory);
    }
    return 0;
}
