/* A receding horizon: the tables of ocp.Horizon, the memory of the solver, and the course of the motion. program.py fills the
 * tables, memory.py the memory; numpy_tick.py is the same tick in NumPy. All arrays are row by row. */
#ifndef PIAFFE_RECEDING_H
#define PIAFFE_RECEDING_H

#include "piaffe.h"
#include "plan.h"

typedef void (*function)(const vd *const *arg, vd *const *res, vd *w);

/* p[to[i]] = s[of[i]] */
typedef struct {
    int count;
    const int *to, *of;
} Copies;

/* The parameter rows of a mode or transition, and the functions of its weights and masks. */
typedef struct {
    const double *rows;
    const Copies *copies;
    function weights, end_weights, fall; /* fall: height, vertical speed and gravity of the falling point; 0 if nothing falls */
    int time_step; /* place of the time step in p */
} Store;

/* A part of the schedule. A node is an entry of the calendar and a tick in it; its row is first[entry] + tick. */
typedef struct {
    int step, half, window, cut, space, rows; /* ticks per step; from a stage to where something acts; of the segment, -1 until the end;
                                             a phase per mode; state space; rows */
    double dt;
    const int *first, *mode;            /* per entry */
    const int *stage;                   /* (rows, 2): row of the store, copies; of a stage that acts at the tick */
    const int *end;                     /* (2, rows, 2), the second half for the horizon's last node */
    const int *link;                    /* (2, rows, 4): transition or -1, row, copies, flags; second half: to the next segment */
    const double *controls;             /* (rows, nu) guess */
    Copies state;                       /* of the sample, in the state */
    Copies acting;                      /* entries of a sample that stages take at their middle */
} Segment;

enum { RESETS = 1, LANDS = 2, OWN = 4 }; /* OWN: a reset of the user */

/* A state space of the schedule's models: functions that move a state and a control by a planar motion; 0 if none moves. */
typedef struct {
    function state, control;
    int nx, nu;
} Space;

typedef struct {
    int piece, length, following;
    long start;
    double lands_at;                    /* height of the falling point at the phase's end; NaN if nothing lands there */
} Entry;

/* A piece of the motion; see ReferenceFunctions. Without functions, its samples are in the tables. */
typedef struct {
    function start, begin, advance, move, sample, pose, pick;
    int num_memory, num_sample, num_schedule, num_start, num_commands, first_entry;
    long first_tick;
    const int *places;                  /* (num_targets): entry of the function's sample, -1 for none */
    const double *schedules;            /* (entries of the piece, num_schedule) */
    const double *begins;               /* (num_start): what begin needs on the declared path */
    const double *command;              /* (num_commands), the caller changes them */
    double first[3], last[3], turn[3];  /* planar frames on the declared path; motion of a cycle */
} Piece;

typedef struct {
    double tick;
    long total, period;                 /* ticks; total -1 if endless; of a cycle of the endless piece */
    int num_entries, cycle, num_pieces, num_segments, num_targets, num_modes, num_transitions;
    const Entry *entries;
    const Segment *segments;
    const Piece *pieces;
    const Space *spaces;
    const double *samples, *frames;     /* (rows, num_targets), (rows, 3) of the first segment's rows */
    const double *initial;              /* (num_targets) */
    const Store *modes, *transitions;
    const Mode *const *mode_tables;
    const Transition *const *transition_tables;
    function moved_sample, pose;        /* of a sample by a motion; planar frame of a state; 0 if nothing moves */
    function placed;                    /* of a sample and the plan's frame in the world: what depends on the world; 0 if nothing does */
    int (*solve)(Problem *, int), (*policy)(Problem *);
    void (*adapt)(Problem *, int, double);
    int lean;                           /* plans have only what low levels and the next plan read */
    int follows;                        /* whether the heights of landings are those of samples, and not those of the entries */
    int num_lanes, num_work;            /* vectors that go into and out of a function of these tables, and that it works with */
    double (*clock)(const Problem *);   /* seconds */
    const int *followed;                /* (num_modes): number of a mode for low levels, -1 for one that they do not follow */
} Horizon;

/* Where a tick is in the motion, see Place. In a course, entry -1: it begins anew, with the last plan as the first guess. */
typedef struct {
    int entry;
    long number, start;
} Place;

/* A part of the horizon, see Span. */
typedef struct {
    int segment, stages, ends, last;
    Place place;
    long first;
} Span;

typedef struct {
    long tick;
    Place place;
    double anchor[3], moved[3], frame[3];
    double *memory;                     /* of the present piece */
} Course;

/* The clock of the motion, see Clock. */
typedef struct {
    double limit, gain;                 /* of a flight [s], no retiming if 0; of the filter */
    long shift, base, flight;           /* ticks by which the motion is late; the same at the flight's start; its place's number */
    double late;                        /* filtered shift of the flight [s] */
} Clock;

typedef struct {
    unsigned char *base;
    size_t used;
} Arena;

/* A node of the horizon. The row of a stage is that of its middle, if something acts there. */
typedef struct {
    Place place;
    long tick;
    int row;
} Node;

/* A plan: header and numbers. The header begins with NUM_PARTS, TICK, ..., then PART numbers for each part. */
/* MOTION and REQUEST: of several motions, that of the plan and the one that is asked for, see motions.h. */
enum { NUM_PARTS, TICK, STATUS, ITERATIONS, HAS_POLICY, MOTION, REQUEST, HEADER };
enum { SEGMENT, NUMBER, ENTRY, MODE, STAGES, FIRST, TRANSITION, FLAGS, LAST, AT_TIMES, AT_X, AT_U, AT_K, AT_FEEDBACK, AT_Q_X, AT_Q_U,
       AT_Q_XX, AT_Q_UX, AT_Q_UU, AT_P, AT_G_MASK, AT_H_MASK, AT_P_TRANSITION, AT_RELAXATION, AT_ROW_SHIFT, AT_MULTIPLIER, AT_PENALTY,
       AT_END_RELAXATION, AT_END_ROW_SHIFT, AT_END_MULTIPLIER, AT_END_PENALTY, PART };
enum { ANCHOR = 0, MOVED = 3, COST = 6, DEFECT, EQUALITY, INEQUALITY, MEASURED_AT, NUMBERS_S, SOLVE_S, POLICY_S, SHIFT,
       WEIGHT, NUM_FIGURES = 16 };
typedef struct planned {
    long *header;
    double *numbers;
    struct plan_phase *phases;          /* of the view */
    struct plan *view;                  /* the same plan as low levels read it */
} Plan;

typedef struct receding {
    const Horizon *horizon;
    Course course;
    int has_plan, began;                /* whether the last plan is finite and continued; whether there was a plan */
    Plan last;                          /* the last plan, which the caller keeps until the next tick is over */
    Options options;
    double latency;
    Clock clock;
    int first_iterations, iterations;
    double adapt_below;                 /* largest defect of a plan after which the numbers of rows adapt; 0: they are fixed */
    double last_equality;               /* largest violation of equalities at the last change of penalties */
    Arena arena;                        /* of the solver's memory, laid out again at every tick */
    Problem *problem;
    Span *spans;
    Node *nodes;                        /* of all parts, one part after another; after a part's nodes its stages' middles */
    int *firsts, num_nodes;             /* per part, its first node; number of nodes and middles */
    double *samples;                    /* per node, (num_targets) */
    double *frames, *memories;          /* of the pieces in the horizon: (num_pieces, 3), (num_pieces, most memory) */
    long *nows;
    int most_memory;
    Block *single;                      /* a node of any mode or transition, before a solve: in the arena */
    double *rows, *x;                   /* a parameter row; a state */
    vd *lanes, *work;                   /* inputs and outputs of functions; where they work: in the arena */
} Receding;

/* Returns 0, or why there is no plan; with NOT_FINITE_PLAN there is one, but the next one begins anew. */
enum { PLANNED, OUTSIDE, NOT_FINITE_STATE, NOT_FINITE_PLAN };
int receding_plan(void *receding, const double *x, double t, const Plan *plan);
/* Bytes of the solver's memory, and numbers and header entries of a plan, for a horizon that begins at a tick. */
void receding_sizes(Receding *r, long k, size_t *bytes, long *numbers, long *entries);
/* Lets the view of a plan refer to its numbers; a tick does this itself. */
void receding_view(const Horizon *h, const Plan *plan);
#endif
