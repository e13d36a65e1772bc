/* A fit of one of many small datasets: its state, and the steps of `fit_many`. */
#ifndef MIHO_MANY_FIT_H
#define MIHO_MANY_FIT_H

#include "many.h"

#define DEPENDENT 1e-7          /* smaller pivots, of columns of length 1, are dependent */

/* A configuration in search coordinates (logarithms of log-scale parameters) and in units; the
   triangular factor (d + 1, d + 1) of derivatives and residuals; and the sum of squares. */
typedef struct {
    double *x, *theta, *R, squares;
    int converged;
} place;

typedef struct {
    const many_data *data;
    const many_starts *starts;
    watch *by;
    workspace *room;
    place here, trial, best;
    double *low, *high;         /* of the box, in search coordinates */
    double *step, *step_low, *step_high, *scale, *D;
    double *chunk;              /* (d + 1, stride): columns to fold */
    double *columns;            /* (d + 1, longest): all results of the tape at a start */
    double *residuals;          /* (longest,) */
    double *looks;              /* of one start, or stored of all */
    uint8_t *is_kept;           /* (brackets size,) stored starts, NULL if none */
    double *q, *solved;         /* of a start (linears,); best with its linear values (d,) */
    double *ends;               /* (brackets,): sums of squares at the ends of descents */
    solver_room solver;
    int64_t stride, longest, rows, descents;
    int64_t first;              /* row of X of this dataset */
    const double *y;
    double zero;                /* largest sum of squares that is 0 up to rounding */
    int stopped;
} fitter;

static inline void spend(fitter *w, double operations) {
    w->stopped = stops_after(operations, w->by);
}
static inline double divisor(double scale) { return scale > 0.0 ? scale : 1.0; }

/* many_descent.c */
void set_coordinates(const fitter *w, const double *theta, double *x);
/* Write a triangular factor of n columns, divided by their scales, to the trial's, which is free:
   else the unit of one parameter could make another one seem to be without effect. */
void divide_columns(fitter *w, const double *R, int64_t side, int64_t n);
/* Descend from a configuration in units, and keep the better minimum. */
void descend_from(fitter *w, const double *theta);

/* many_starts.c: write the start of a bracket with the lowest sum of squares over its linear
   parameters to w.solved; 0 if none is finite. */
int best_start(fitter *w, int64_t bracket);
#endif
