/* Thousands of small fits of one formula, each by separate descents. */
#ifndef MIHO_MANY_H
#define MIHO_MANY_H

#include "search.h"

/* Datasets of columns X (p, N) and y; dataset k has the rows from ends[k] to ends[k + 1] of both,
   or all N rows of a `shared` X. The results of the tape are d derivatives and the value, which is
   jointly linear in the `linear` parameters. */
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

/* Starts (brackets, size, d) in units, for all datasets: one descent from the best of each bracket,
   at its best linear parameters, until `few` have all ended in one optimum, the evidence is enough,
   or no bracket is left. With `own` each start is descended from; brackets are then datasets, or 1
   for all. */
typedef struct {
    const double *starts;
    int64_t brackets, size, few;
    int own;
} many_starts;

/* Whether the descent converged; whether there is evidence for its minimum; whether the derivatives
   are too close to dependence for this covariance. */
enum { CONVERGED, EVIDENT, SINGULAR, FLAGS };
/* For each requested dataset: configuration (d,), sum of squares, covariance (d, d), NaN for
   parameters at a bound, and flags (FLAGS,). */
typedef struct {
    double *thetas, *squares, *covariance;
    uint8_t *flags;
} many_ends;

/* Fit the datasets `which` (n,); 0 without memory. After a stop the remaining results are
   unchanged. */
int fit_many(const many_data *data, const many_starts *starts, const int64_t *which, int64_t n,
             watch *by, many_ends *out);
#endif
