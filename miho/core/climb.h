/* Mutation steps: Eq. 2 of the paper, and line 6 of its Alg. 1. */
#ifndef MIHO_CLIMB_H
#define MIHO_CLIMB_H

#include "tape.h"

/* Mutants of each of the n rows of P, `more` + 1 times: `first` (n, d), then P plus sigma (more, d)
   times noise (more, n, d), within the bounds (d,). P and its losses L (n,) are changed in place.
   Improvements of `best` are listed: number of the evaluation, loss, mutant. */
typedef struct {
    int64_t n, d, more;
    const double *first, *noise, *sigma, *low, *high;
    double *P, *L;
    double best, target;
    int early_stopping;
    int64_t *at;
    double *losses, *thetas;
} climb;

/* Whole steps, improvements, and losses that are not finite. */
typedef struct { int64_t steps, improvements, nans, infinities; } climbed;

/* Stop after the step that reaches the target. False without memory. */
int climb_by_tape(const tape *t, const measurements *m, climb *c, climbed *done);
#endif
