/* Replays check.bin, a recorded closed loop, and compares. First as a robot would run it. Then each plan starts from the recorded
 * one before, and each tick follows the recorded plan.
 *
 * With the compiler, the flags and the width of a vector of the record, all numbers are the same bit for bit. With others, plans
 * differ by rounding errors that an iterative method enlarges. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "names.h"
#include "private.h"
#include "constants.h"

static const double PLANS = 1e-6, TICKS = 1e-9; /* largest differences, relative to 1 or to the size of a number */

enum { ENDED, PLANNED_AT, TICKED_AT };
enum { SIZE_X, SIZE_U, SIZE_COMMANDS, SIZE_PLANNER, SIZE_ENTRIES, SIZE_NUMBERS, WIDTH, COUNT_PLANS, COUNT_TICKS, NUM_SIZES };
enum { MOST_PLANNER = 256 * NUM_MOTIONS };

typedef struct {
    double t, x[NAME_NX], commands[NUM_COMMANDS + 1], planner[MOST_PLANNER], u[NAME_NU];
    int64_t header[NUM_ENTRIES];
} Event;

static FILE *file;
static int64_t sizes[NUM_SIZES];
static double first[NUM_NUMBERS], second[NUM_NUMBERS];
static unsigned char known[NUM_NUMBERS];

static void get(void *to, size_t bytes)
{
    if (fread(to, 1, bytes, file) == bytes) return;
    fprintf(stderr, "check.bin ends too early\n");
    exit(2);
}

static int64_t get_number(void)
{
    int64_t number;
    get(&number, sizeof number);
    return number;
}

static void get_doubles(double *to, int64_t count) { get(to, sizeof(double) * (size_t)count); }

/* Reads what was recorded of a plan's numbers, and marks them as known. */
static void get_plan(double *numbers)
{
    memset(known, 0, sizeof known);
    for (int64_t at; (at = get_number()) >= 0;) {
        const int64_t count = get_number();
        if (count < 0 || at + count > NUM_NUMBERS) exit(2);
        get_doubles(numbers + at, count);
        memset(known + at, 1, (size_t)count);
    }
}

static int64_t next_event(Event *e, double *numbers)
{
    const int64_t kind = get_number();
    if (kind == ENDED) return kind;
    get_doubles(&e->t, 1);
    get_doubles(e->x, NAME_NX);
    if (kind == TICKED_AT) {
        get_doubles(e->u, NAME_NU);
        return kind;
    }
    get_doubles(e->commands, NUM_COMMANDS);
    get_doubles(e->planner, sizes[SIZE_PLANNER]);
    get(e->header, sizeof e->header);
    get_plan(numbers);
    return kind;
}

static void open_record(const char *path)
{
    char magic[8];
    if (!(file = fopen(path, "rb"))) {
        fprintf(stderr, "%s cannot be read\n", path);
        exit(2);
    }
    get(magic, sizeof magic);
    get(sizes, sizeof sizes);
    if (!memcmp(magic, "PIAFFE-1", 8) && sizes[SIZE_X] == NAME_NX && sizes[SIZE_U] == NAME_NU && sizes[SIZE_COMMANDS] == NUM_COMMANDS &&
        sizes[SIZE_ENTRIES] == NUM_ENTRIES && sizes[SIZE_NUMBERS] == NUM_NUMBERS && sizes[SIZE_PLANNER] <= MOST_PLANNER) return;
    fprintf(stderr, "%s is the record of another controller\n", path);
    exit(2);
}

typedef struct {
    double plans, ticks;      /* largest differences */
    long num_plans, num_ticks; /* that differ in a bit */
} Differences;

/* A hash of all computed numbers, to compare machines. */
static uint64_t digest = 14695981039346656037u;

static void add_to_digest(double number)
{
    uint64_t bits;
    memcpy(&bits, &number, sizeof bits);
    for (int i = 0; i < 8; i++) digest = (digest ^ (bits >> (8 * i) & 255)) * 1099511628211u;
}

/* Compares numbers; `only` marks those that count. */
static void compare(const double *a, const double *b, const unsigned char *only, long count, double *worst, long *differ)
{
    int same = 1;
    for (long i = 0; i < count; i++) {
        if (only && !only[i]) continue;
        add_to_digest(a[i]);
        if (!memcmp(&a[i], &b[i], sizeof *a)) continue;
        same = 0;
        double d = fabs(a[i] - b[i]) / fmax(1.0, fabs(b[i]));
        if (!(d <= *worst)) *worst = d;
    }
    *differ += !same;
}

/* The states and controls of a plan. */
static void mark_iterate(const Receding *r, const int64_t *header, unsigned char *marks)
{
    memset(marks, 0, NUM_NUMBERS);
    for (int64_t i = 0; i < header[NUM_PARTS]; i++) {
        const int64_t *part = header + HEADER + i * PART;
        const Mode *m = r->horizon->mode_tables[part[MODE]];
        memset(marks + part[AT_X], 1, (size_t)((part[STAGES] + 1) * m->nx));
        memset(marks + part[AT_U], 1, (size_t)(part[STAGES] * m->nu));
    }
}

/* Sets what a planner has beside its last plan; returns what follows. */
static const double *set_planner(Receding *r, const double *p)
{
    r->has_plan = (int)p[0], r->began = (int)p[1];
    r->course.tick = (long)p[2];
    r->course.place = (Place){(int)p[3], (long)p[4], (long)p[5]};
    memcpy(r->course.anchor, p + 6, sizeof r->course.anchor);
    memcpy(r->course.moved, p + 9, sizeof r->course.moved);
    memcpy(r->course.frame, p + 12, sizeof r->course.frame);
    r->clock.shift = (long)p[15], r->clock.base = (long)p[16], r->clock.flight = (long)p[17], r->clock.late = p[18];
    r->last_equality = p[19];
    memcpy(r->course.memory, p + 20, sizeof(double) * (size_t)r->most_memory);
    return p + 20 + r->most_memory;
}

/* Sets what the next plan depends on: the recorded planners, and the recorded plans before. */
static void set_planners(NAME *c, const double *p, int last, int before)
{
    int active = 0;
@RESTARTED@    for (int i = 0; i < NUM_MOTIONS; i++) p = set_planner(NAME_planner(c, i), p);
    NAME_planner(c, active)->last = c->places[last].plan;
    (void)before;
}

/* Runs the controller as a robot would; the measured states are the recorded ones. */
static Differences run(NAME *c, const char *path)
{
    Differences found = {0};
    Event e;
    NAME_output out;
    NAME_forget(c);
    open_record(path);
    for (int64_t kind; (kind = next_event(&e, first)) != ENDED;) {
        if (kind == PLANNED_AT) {
            memcpy(c->told[c->commands.acting], e.commands, sizeof(double) * NUM_COMMANDS);
            if (NAME_plan(c, e.x, e.t)) exit(1);
            const struct place *made = &c->places[c->plans.middle & ~(unsigned)FRESH];
            compare(made->numbers, first, known, NUM_NUMBERS, &found.plans, &found.num_plans);
        } else {
            NAME_tick(c, e.x, e.t, &out);
            compare(out.torque, e.u, NULL, NAME_NU, &found.ticks, &found.num_ticks);
        }
    }
    fclose(file);
    return found;
}

static void load(NAME *c, struct place *p, const int64_t *header, const double *numbers)
{
    for (int i = 0; i < NUM_ENTRIES; i++) p->header[i] = (long)header[i];
    memcpy(p->numbers, numbers, sizeof p->numbers);
    receding_view(NAME_planner(c, (int)p->header[MOTION])->horizon, &p->plan);
}

/* Each plan starts from the recorded one before, each tick follows the recorded plan. */
static Differences restart(NAME *c, const char *path)
{
    static unsigned char iterate[NUM_NUMBERS];
    Differences found = {0};
    Event e;
    NAME_output out;
    int plans = 0, last = 0, earlier = 1;
    double *now = first, *before = second;
    NAME_forget(c);
    open_record(path);
    for (int64_t kind; (kind = next_event(&e, now)) != ENDED;) {
        const int next = 3 - last - earlier;
        struct place *made = &c->places[next];
        if (kind == PLANNED_AT) {
            if (plans) set_planners(c, e.planner, last, earlier);
            memcpy(c->memory.commands, e.commands, sizeof(double) * NUM_COMMANDS);
            if (NAME_make(c, e.x, e.t, &made->plan)) exit(1);
            mark_iterate(NAME_planner(c, (int)e.header[MOTION]), e.header, iterate);
            for (int i = 0; i < NUM_NUMBERS; i++) iterate[i] &= known[i];
            compare(made->numbers, now, iterate, NUM_NUMBERS, &found.plans, &found.num_plans);
            load(c, made, e.header, now);
            earlier = last, last = next, plans++;
            if (plans == 1) c->memory.low.plan = &made->view;
            double *swap = now;
            now = before, before = swap;
        } else {
            const struct place *newest = &c->places[last]; /* it acts from its start on */
            if (newest->numbers[newest->header[HEADER + AT_TIMES]] <= e.t + SAME_TIME) c->memory.low.plan = &newest->view;
            piaffe_tick(&c->memory.low, e.x, e.t, out.torque, &c->memory.outcome);
            compare(out.torque, e.u, NULL, NAME_NU, &found.ticks, &found.num_ticks);
        }
    }
    fclose(file);
    return found;
}

int main(int count, char **arguments)
{
    const char *path = count > 1 ? arguments[1] : "check.bin";
    const int exact = count > 2 && !strcmp(arguments[2], "--bitwise");
    const size_t size = NAME_memory_size();
    void *memory = aligned_alloc(64, size);
    NAME *c = NAME_init(memory, size, NULL);
    if (!c) return 2;
    Differences free_run = run(c, path), restarted = restart(c, path);
    const int same = !(free_run.num_plans + free_run.num_ticks + restarted.num_plans + restarted.num_ticks);
    const int close = restarted.plans <= PLANS && restarted.ticks <= TICKS;
    printf("%lld plans, %lld ticks; vectors of %d numbers, recorded with %lld; %zu bytes of memory\n", (long long)sizes[COUNT_PLANS],
           (long long)sizes[COUNT_TICKS], PIAFFE_W, (long long)sizes[WIDTH], size);
    printf("digest of all numbers: %016llx\n", (unsigned long long)digest);
    if (same) printf("bitwise equal to the record\n");
    else
        printf("as on a robot: %ld plans and %ld ticks differ, by %.1e and %.1e at most\n"
               "restarted from recorded plans: %ld plans and %ld ticks differ, by %.1e (allowed %.0e) and %.1e (%.0e) at most\n",
               free_run.num_plans, free_run.num_ticks, free_run.plans, free_run.ticks, restarted.num_plans, restarted.num_ticks,
               restarted.plans, PLANS, restarted.ticks, TICKS);
    free(memory);
    if (exact ? same : same || close) return puts("passed"), 0;
    return puts("FAILED"), 1;
}
