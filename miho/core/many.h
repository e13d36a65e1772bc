/* Thousands of small fits of one formula, each by descents of its own. */
#ifndef MIHO_MANY_H
#define MIHO_MANY_H

#include "search.h"

/* Datasets of columns X (p, N) and y: the k-th has the rows from ends[k] to ends[k + 1] of both;
   or, if X is `shared`, all N of X. The tape's results are d derivatives and the value, which is
   linear in the `linear` parameters jointly. */
typedef struct {
    const tape *tape;
    const double *X, *y;
    const int64_t *ends;
    int64_t N, datasets, d;
    int shared;
    const double *low, *high;
    const uint8_t *log;
    const int64_t *linear;
    int64_t linears;
} many_data;

/* Starts (brackets, size, d) in units, for all datasets: a descent from the best of each bracket,
   at its best values of the linear parameters, until `few` have all ended in one optimum, or the
   evidence is enough, or no bracket is left. With `own`, starts (brackets, size, d) are for one
   dataset each, or for all if brackets is 1, and each of them is descended from. */
typedef struct {
    const double *starts;
    int64_t brackets, size, few;
    int own;
} many_starts;

/* Of a dataset: whether the descent converged; whether there is evidence of its minimum; whether
   the derivatives are too close to being dependent for the covariance to be found here. */
enum { CONVERGED, EVIDENT, SINGULAR, FLAGS };
/* Of each dataset that was asked for: a configuration (d,), its sum of squares, the covariance
   (d, d), NaN for what is at a bound, and flags (FLAGS,). */
typedef struct {
    double *thetas, *squares, *covariance;
    uint8_t *flags;
} many_ends;

/* Whether to stop, asked every few milliseconds. */
typedef struct {
    int (*stops)(void *state);
    void *state;
} watch;

/* Fit the datasets `which` (n,); 0 without memory. A watch that stops leaves the others as they
   were. */
int fit_many(const many_data *data, const many_starts *starts, const int64_t *which, int64_t n,
             const watch *by, many_ends *out);
#endif
