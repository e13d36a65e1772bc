/* Gauss-Newton descents of many candidates side by side: the records.

   Names and arrays are the same as in miho/compiled/gauss_newton_candidates.py, which documents
   them. Sums over rows use columns.h, so that a search has the same bits on every processor. */
#ifndef MIHO_SEARCH_H
#define MIHO_SEARCH_H

#include <string.h>
#include "tape.h"

#define CHUNK 512           /* rows per chunk; derivatives stay in the first-level cache */

/* Stages of a candidate. A stop within the factor of updated derivatives leaves FACTOR. */
enum { FACTOR = -1, ENTER, SLOPES, READY, TRIED, RECORD, DONE, AT_KNOWN, UNUSABLE };
/* Position of a bracket, in `place`. */
enum { PHASE, AT_LEVEL, SIZE, ACTIVE, STORED, PLACES };
/* Phases of a bracket. */
enum { SCREEN, RUNG, LEAD, FINISH, REVIVE, POLISH, CLOSED, EMPTY, RETURNED, SOLVED };
/* End of a block of steps: no candidate needs anything; the next evaluation would exceed the
   allowed rows, or Ctrl-C; or the target is reached. */
enum { FINISHED, PAUSED, REACHED, RUNNING };
/* Counts of a block, in `tally`. */
enum { SPENT, IMPROVEMENTS, NANS, INFINITIES, UNUSABLES, TALLIES };

typedef void (*residual_function)(const tape *, const double *theta, const double *X, int64_t N,
                                  const double *y, int64_t i, int64_t j, double *out);
typedef void (*column_function)(const tape *, const double *theta, const double *X, int64_t N,
                                int64_t i, int64_t j, double *out, int64_t stride);

/* Residuals and derivatives of d parameters at columns X (p, N), and y (N,), whose first rows are
   the rows of each level; and the box. */
typedef struct {
    residual_function residuals;
    column_function slopes;
    const tape *value_tape, *slope_tape; /* their argument */
    const struct level *sums;
    const double *X, *y;
    int64_t N, d;
    const double *low, *high, *origin, *width;
    const uint8_t *log;
    const int64_t *linear, *nonlinear;
    int64_t linears, nonlinears;
    const int64_t *level_rows;
    int64_t levels;
} problem;

/* Known minima. */
typedef struct {
    const double *x, *loss, *sums;
    const uint8_t *determined;
    int64_t count;
} known_minima;

typedef struct {
    int64_t eta, steps, lead;
    double reach;
    int64_t secants;
    double tolerance, level_tolerance, digits, patience, progress, rounding;
    int64_t slope_cost, compiled, projects, solved;
    double rung_budget;
    int64_t allowance, room;
} search_settings;

/* Rules of a block of steps. */
typedef struct {
    int64_t level, last, steps;
    double reach;
    int64_t secants;
    double tolerance;
    int64_t patience, allowance;
    double progress, near, better;
    int64_t ending;
    double rounding;
} step_rules;

/* A row of `counts`, and the middle part of a row of `numbers`. */
typedef struct {
    int64_t stage, stage_after_record, secants, trials, spent, spent_at_mark, projects;
} candidate_counts;
typedef struct {
    double loss, damping, growth, predicted_gain, loss_at_mark, fading;
} candidate_numbers;
#define COUNTS 7
#define NUMBERS 6

/* One candidate. `derivatives` (d + 1, m) is NULL if they are not stored. */
typedef struct {
    double *x, *trial, *q, *D, *sums, *R, *derivatives;
    candidate_numbers *is;
    candidate_counts *has;
} candidate;

/* Minimise |R s + q|^2 + |scale s|^2 within low <= s <= high. R is triangular in its first n rows
   and columns; the elements of q are `step` numbers apart. */
typedef struct {
    const double *R, *q, *scale, *low, *high;
    int64_t side, step, n;
} box_problem;

/* Work arrays of the solver, for at most d parameters: free (d,), solution (d,), columns (d + 1,
   whole(2 d)), T (d + 1, d + 1). The solver stops if `by`, unless it is NULL, says so. */
typedef struct {
    double *free, *solution, *columns, *T;
    int64_t d;
    const struct level *level;
    watch *by;
} solver_room;

/* Work arrays of steps. theta, step, low, high, scale (d,): the configuration in units, a step, its
   bounds and damping. sums (levels,). T (d + 1, d + 1): a triangular factor. chunk (d + 1, CHUNK):
   columns to fold into T. slopes (d, CHUNK), residuals (residual_room,). */
typedef struct {
    double *theta, *step, *low, *high, *scale, *sums, *T, *chunk, *slopes, *residuals;
    int64_t residual_room;
    solver_room solver;
} work_room;

/* A bracket of at most n candidates, and the rules and counts of the current block. */
typedef struct {
    problem p;
    known_minima minima;
    search_settings settings;
    step_rules rules;
    work_room w;
    int64_t n, m;           /* candidates; rows of this level */
    double *numbers, *R, *stored;
    int64_t *counts, *place, *order;
    int64_t stored_room;
    int64_t most;           /* rows that may be used */
    double best, target;
    int64_t events;         /* improvements that may be listed */
    int64_t *at, *tally;
    double *losses, *thetas;
} search;

static inline double larger(double a, double b) { return b > a ? b : a; }
static inline double smaller(double a, double b) { return b < a ? b : a; }
static inline double between(double low, double x, double high) {
    return smaller(larger(x, low), high);
}
/* Zeros up to the next multiple of eight, as `fold` takes columns. */
static inline void pad(double *column, int64_t rows) {
    for (int64_t i = rows; i % 8; i++) column[i] = 0.0;
}
/* Whether a call has to end; its last step is then undone. */
static inline int is_stopped(const search *s) { return s->w.solver.by && s->w.solver.by->stopped; }
static inline void copy(const double *from, double *to, int64_t n) {
    memcpy(to, from, (size_t)n * sizeof(double));
}

/* triangular.c */
void solve_in_box(const box_problem *b, double *s, const solver_room *room);
double square_norm(const box_problem *b, const double *s);

/* steps.c */
int is_free(double x);
int is_copy(const search *s, const candidate *better, const candidate *c);
void take_factor(const search *s, candidate *c);
void factor_secant(search *s, candidate *c);
int prepare(search *s, candidate *c);
void after_evaluation(search *s, candidate *c, double loss);

/* descent.c: give a candidate its steps, as far as allowed; returns how this ended. */
int descend(search *s, int64_t i);

/* bracket.c */
candidate candidate_at(const search *s, int64_t i);
/* Run a bracket to its end, or as far as allowed; returns how it ended. */
int run_bracket(search *s);
/* Numbers of work arrays, besides residuals. */
int64_t room_beside_residuals(int64_t d, int64_t levels);
void divide_room(search *s, double *room, int64_t size);
#endif
