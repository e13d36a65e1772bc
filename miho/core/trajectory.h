/* Trajectories and their sensitivities by the classical Runge-Kutta method: the records. */
#ifndef MIHO_TRAJECTORY_H
#define MIHO_TRAJECTORY_H

#include "tape.h"

#define MOST_POINTS MOST_ROWS /* points of derivatives side by side */
#define APART (MOST_POINTS + 8) /* from one derivative to the next; no power of two (cache) */

/* Fields of miho.models.layout.Course: N times, q inputs, S states, d parameters, K outputs, R
   rows of data, M starts. */
typedef struct {
    const double *t, *u, *values;
    const int64_t *first, *rows, *output, *reset, *parameters;
    int64_t N, q, S, d, K, R, M, substeps;
    int held, restart;
} course;

/* The tapes of rates (S,) and outputs (K,) have the inputs x (S,) and p (d,), and the parameters t
   and u (q,). */
typedef struct { const tape *rates, *outputs; } motion;

/* Nonzero derivatives of `rows` rates or outputs. The inputs of the tape are t, u (q,) and x (S,),
   its parameters p (d,); result i is the derivative of at[i, 0] with respect to state at[i, 1], or
   parameter at[i, 1] - S. In at (count, 2) the `chained` derivatives by states come first; both
   parts are in the order of rows. `width` numbers stand for the d parameters. */
typedef struct slopes {
    const tape *tape;
    const int64_t *at;
    int64_t count, chained, rows, states, width;
} slopes;

/* Outputs out (n, R) of parameter rows thetas (n, d); 0 without memory. */
int trajectory_solve(const motion *m, const course *c, const double *thetas, int64_t n,
                     double *out);
/* Derivatives of the outputs, out (R, d), at theta (d,); 0 without memory. */
int trajectory_derive(const motion *m, const slopes of[2], const course *c, const double *theta,
                      double *out);
#endif
