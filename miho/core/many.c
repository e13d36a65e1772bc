/* Many small fits: descents until their ends are evidence, and the covariance. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "many_fit.h"

#define ROUNDING 3.5e-15        /* residuals below this share of the data are rounding */
/* Evidence, see miho/optim/evidence.py. */
#define AGREEING 1e-4
#define ENOUGH 5
#define SHARE 0.25
#define BETTER 0.025
#define MOST_KEPT 4000000       /* stored values at common starts */

static int in_optimum(const fitter *w, double best, double end) {
    return end <= best + AGREEING * best + w->zero;
}

/* Whether the ends of descents are evidence for the best optimum (Boender and Rinnooy Kan, 1987, as
   in miho/optim/evidence.py), or a few descents have all ended in it. */
static int is_enough(const fitter *w) {
    int64_t n = w->descents, agreeing = 0, optima = 0;
    if (w->best.squares <= w->zero) return 1;
    for (int64_t k = 0; k < n; k++) {
        int is_new = 1;
        agreeing += in_optimum(w, w->best.squares, w->ends[k]);
        for (int64_t j = 0; is_new && j < k; j++) {
            double a = w->ends[j], b = w->ends[k];
            is_new = !in_optimum(w, smaller(a, b), larger(a, b));
        }
        optima += is_new;
    }
    if (n >= w->starts->few && agreeing == n && isfinite(w->best.squares)) return 1;
    return agreeing >= ENOUGH && (double)agreeing >= SHARE * (double)n &&
        (double)optima <= BETTER * (double)(n * (n - 1));
}

/* Covariance at the best optimum; 0 if the derivatives are nearly dependent. */
static int set_covariance(fitter *w, double *out) {
    const many_data *data = w->data;
    int64_t d = data->d, side = d + 1, stride = whole(2 * d), n = 0;
    double *columns = w->solver.columns, *T = w->solver.T, *norms = w->scale, *free = w->step;
    for (int64_t k = 0; k < d * d; k++) out[k] = NAN;
    for (int64_t k = 0; k < d; k++)
        if (w->best.theta[k] > data->low[k] && w->best.theta[k] < data->high[k])
            free[n++] = (double)k;
    if (!n || w->rows <= n || !isfinite(w->best.squares)) return 1;
    for (int64_t j = 0; j < n; j++) {
        int64_t k = (int64_t)free[j];
        double square = 0.0;
        for (int64_t row = 0; row <= k; row++)
            square += w->best.R[row * side + k] * w->best.R[row * side + k];
        norms[j] = sqrt(square);
        if (!isfinite(square) || !(square > 0.0)) return 0;
        for (int64_t row = 0; row < d; row++)
            columns[j * stride + row] = row <= k ? w->best.R[row * side + k] / norms[j] : 0.0;
        pad(columns + j * stride, d);
        if (data->log[k]) norms[j] /= w->best.theta[k];
    }
    memset(T, 0, (size_t)(side * side) * sizeof(double));
    w->solver.level->fold(T, side, columns, stride, whole(d), n, NULL);
    for (int64_t j = 0; j < n; j++)
        if (fabs(T[j * side + j]) < DEPENDENT) return 0;
    /* Inverse of the factor, column by column, in place of the columns. */
    for (int64_t j = 0; j < n; j++)
        for (int64_t i = j; i >= 0; i--) {
            double value = i == j ? 1.0 : 0.0;
            for (int64_t k = i + 1; k <= j; k++) value -= T[i * side + k] * columns[j * stride + k];
            columns[j * stride + i] = value / T[i * side + i];
        }
    double variance = w->best.squares / (double)(w->rows - n);
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = i; j < n; j++) {
            double value = 0.0;
            for (int64_t k = j; k < n; k++)
                value += columns[k * stride + i] * columns[k * stride + j];
            value *= variance / (norms[i] * norms[j]);
            out[(int64_t)free[i] * d + (int64_t)free[j]] = value;
            out[(int64_t)free[j] * d + (int64_t)free[i]] = value;
        }
    return 1;
}

/* Fit dataset k, the i-th requested one. */
static void fit_one(fitter *w, int64_t k, int64_t i, many_ends *out) {
    const many_data *data = w->data;
    const many_starts *starts = w->starts;
    int64_t d = data->d, bracket = starts->brackets == 1 ? 0 : i;
    w->rows = data->ends[k + 1] - data->ends[k];
    w->first = data->shared ? 0 : data->ends[k];
    w->y = data->y + data->ends[k];
    w->zero = 0.0;
    for (int64_t start = 0; start < w->rows; start += CHUNK) {
        int64_t rows = w->rows - start < CHUNK ? w->rows - start : CHUNK;
        const double *y = w->y + start;
        w->zero += ROUNDING * ROUNDING * data->tape->level->product_sum(y, y, rows);
    }
    w->best.squares = INFINITY;
    w->best.converged = 0;
    for (int64_t j = 0; j < d; j++) w->best.theta[j] = NAN;
    w->descents = 0;
    int evident = starts->own;
    if (starts->own) {
        for (int64_t j = 0; j < starts->size && !w->stopped; j++)
            descend_from(w, starts->starts + (bracket * starts->size + j) * d);
    } else {
        for (int64_t j = 0; j < starts->brackets && !evident && !w->stopped; j++) {
            if (!best_start(w, j)) continue;
            descend_from(w, w->solved);
            evident = is_enough(w);
        }
    }
    if (w->stopped) return;
    copy(w->best.theta, out->thetas + i * d, d);
    out->squares[i] = w->best.squares;
    uint8_t *flags = out->flags + i * FLAGS;
    flags[CONVERGED] = (uint8_t)w->best.converged;
    flags[EVIDENT] = (uint8_t)evident;
    flags[SINGULAR] = (uint8_t)!set_covariance(w, out->covariance + i * d * d);
}

/* Allocate all work arrays; 0 without memory. */
static int open_room(fitter *w) {
    const many_data *data = w->data;
    const many_starts *starts = w->starts;
    int64_t d = data->d, side = d + 1, longest = 1;
    for (int64_t k = 0; k < data->datasets; k++)
        if (data->ends[k + 1] - data->ends[k] > longest)
            longest = data->ends[k + 1] - data->ends[k];
    w->longest = starts->own ? 0 : whole(longest);
    w->stride = whole(longest < CHUNK ? longest : CHUNK) + 8;
    int64_t L = data->linears, number = starts->brackets * starts->size;
    int64_t look = (L + 1) * w->longest + L * L;
    int keeps = data->shared && !starts->own && number <= MOST_KEPT / look;
    int64_t descents = starts->own ? starts->size : starts->brackets;
    int64_t size = 17 * d + 4 * side * side + descents + 7 + side * (whole(2 * d) + w->stride) +
        (d + 2) * w->longest + look * (keeps ? number : 1);
    double *room = w->low = malloc((size_t)size * sizeof(double));
    w->is_kept = keeps ? calloc((size_t)number, 1) : NULL;
    w->room = tape_open(data->tape, longest);
    if (!room || (keeps && !w->is_kept) || !w->room) return 0;
    double **const vectors[] = {
        &w->low, &w->high, &w->step, &w->step_low, &w->step_high, &w->scale, &w->D,
        &w->solver.free, &w->solver.solution, &w->here.x, &w->here.theta, &w->trial.x,
        &w->trial.theta, &w->best.x, &w->best.theta, &w->q, &w->solved,
    };
    for (int k = 0; k < 17; k++, room += d) *vectors[k] = room;
    double **const squares[] = {&w->here.R, &w->trial.R, &w->best.R, &w->solver.T};
    for (int k = 0; k < 4; k++, room += side * side) *squares[k] = room;
    w->ends = room;
    w->solver.columns = aligned(w->ends + descents);
    w->chunk = w->solver.columns + side * whole(2 * d);
    w->columns = w->chunk + side * w->stride;
    w->residuals = w->columns + side * w->longest;
    w->looks = w->residuals + w->longest;
    w->solver.d = d;
    w->solver.level = data->tape->level;
    set_coordinates(w, data->low, w->low);
    set_coordinates(w, data->high, w->high);
    return 1;
}

int fit_many(const many_data *data, const many_starts *starts, const int64_t *which, int64_t n,
             watch *by, many_ends *out) {
    fitter w;
    memset(&w, 0, sizeof w);
    w.data = data;
    w.starts = starts;
    w.by = by;
    int done = open_room(&w);
    for (int64_t i = 0; done && i < n && !w.stopped; i++) fit_one(&w, which[i], i, out);
    tape_close(w.room);
    free(w.is_kept);
    free(w.low);
    return done;
}
