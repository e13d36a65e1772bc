/* A population of hypotheses about parameters that change, updated by one row. NumPy form, with the
   reasons: miho/online/population.py. */
#ifndef MIHO_TRACK_H
#define MIHO_TRACK_H

#include "tape.h"

#define MOST_SLOTS 64
#define MOST_TRACKED 64         /* parameters, outputs or inputs */

/* K hypotheses of d parameters; m outputs; p inputs, the first q of which have noise. The columns of
   the tape are the inputs, then the parameters. Its results are, for each output, the value, the
   d derivatives by the parameters, and the q derivatives by the inputs with noise. The first n inputs
   are states, and the first n outputs are the same states at the end of the row. */
typedef struct {
    const tape *tape;
    int64_t K, d, m, p, q, n;
} track_sizes;

/* Lengths of the arrays of `track_update`. */
int64_t length_of_memory(const track_sizes *of);
int64_t length_of_rules(const track_sizes *of);
int64_t length_of_estimate(const track_sizes *of);

/* Update the memory by a row of p inputs, m outputs and the time, and write the estimate: mean (d,),
   covariance (d, d), weights (K,), means (K, d) and deviations (K, d). 0 without memory. */
int track_update(const track_sizes *of, const double *rules, const double *row, double *memory,
                 double *estimate);
/* A mixture of n normal distributions of d numbers. */
typedef struct {
    const double *weights, *means, *deviations; /* (n,), (n, d), (n, d) */
    int64_t n, d;
} mixture;

/* Half widths (d,) around a centre that hold a probability of the mixture. */
void mixture_reach(const mixture *of, const double *centre, double probability, double *out);
#endif
