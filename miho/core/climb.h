/* Steps of mutation and acceptance: Eq. 2 of the paper, and line 6 of its Alg. 1. */
#ifndef MIHO_CLIMB_H
#define MIHO_CLIMB_H

#include "tape.h"

/* A mutant of each of the n rows of P, `more` + 1 times: `first` (n, d), then P plus sigma (more, d)
   times noise (more, n, d), between the bounds (d,). P and L, their losses (n,), are changed in
   place. Improvements of `best` are listed: the number of the evaluation, its loss, its mutant. */
typedef struct {
    int64_t n, d, more;
    const double *first, *noise, *sigma, *low, *high;
    double *P, *L;
    double best, target;
    int early_stopping;
    int64_t *at;
    double *losses, *thetas;
} climb;

/* What was done: whole steps, improvements, and losses that are not finite. */
typedef struct { int64_t steps, improvements, nans, infinities; } climbed;

/* End after the step that reaches the target. False without memory. */
int climb_by_tape(const tape *t, const measurements *m, climb *c, climbed *done);
#endif
