/* Starts of descents: the best of a bracket, at its best linear parameters. */
#include <math.h>
#include "many_fit.h"

/* Values at a start (rows,), an orthonormal basis of the columns of the linear parameters (linears,
   rows), and their triangular factor (linears, linears) in it. */
typedef struct {
    double *values, *basis, *factor;
} look;

/* Place of the stored or new evaluation of a start. */
static look look_of(const fitter *w, int64_t start) {
    int64_t L = w->data->linears, size = (L + 1) * w->longest + L * L;
    double *values = w->looks + (w->is_kept ? start * size : 0);
    return (look){values, values + w->longest, values + (L + 1) * w->longest};
}

/* Evaluate a start by the Gram-Schmidt method; a column that depends on previous ones is left out,
   with a pivot of 0. */
static look look_at(fitter *w, int64_t start, const double *theta) {
    const many_data *data = w->data;
    int64_t L = data->linears, n = w->rows, padded = whole(n);
    const level *level = data->tape->level;
    look at = look_of(w, start);
    if (w->is_kept && w->is_kept[start]) return at;
    tape_start(data->tape, theta, w->room);
    tape_continue(data->tape, data->X, data->N, w->first, w->first + n, w->columns, w->longest,
                  w->room);
    copy(w->columns + data->d * w->longest, at.values, n);
    for (int64_t j = 0; j < L; j++) {
        double *q = at.basis + j * w->longest;
        copy(w->columns + data->linear[j] * w->longest, q, n);
        pad(q, n);
        double before = sqrt(level->product_sum(q, q, padded));
        for (int64_t i = 0; i < j; i++) {
            const double *other = at.basis + i * w->longest;
            double product = at.factor[i * L + j] = level->product_sum(other, q, padded);
            EACH_ROW for (int64_t k = 0; k < n; k++) q[k] -= product * other[k];
        }
        double norm = sqrt(level->product_sum(q, q, padded));
        int dependent = norm <= DEPENDENT * before;
        for (int64_t k = 0; k < n; k++) q[k] = dependent ? 0.0 : q[k] / norm;
        at.factor[j * L + j] = dependent ? 0.0 : norm;
    }
    if (w->is_kept) w->is_kept[start] = 1;
    spend(w, (double)(n * (data->tape->length + L * L + 1)));
    return at;
}

/* Solve for the linear parameters within the box, from their values at a start, into w.step;
   returns the increase of the sum of squares that the box causes. */
static double solve_linear(fitter *w, const look *at, const double *theta) {
    const many_data *data = w->data;
    int64_t L = data->linears;
    int inside = 1;
    for (int64_t j = L - 1; j >= 0; j--) {
        double right = w->q[j], pivot = at->factor[j * L + j], start = theta[data->linear[j]];
        for (int64_t k = j + 1; k < L; k++) right -= at->factor[j * L + k] * w->step[k];
        w->step[j] = pivot > 0.0 ? right / pivot : 0.0;
        w->step_low[j] = data->low[data->linear[j]] - start;
        w->step_high[j] = data->high[data->linear[j]] - start;
        inside = inside && w->step_low[j] <= w->step[j] && w->step[j] <= w->step_high[j];
    }
    if (inside) return 0.0;
    for (int64_t j = 0; j < L; j++) {
        double square = 0.0;
        for (int64_t k = 0; k <= j; k++) square += at->factor[k * L + j] * at->factor[k * L + j];
        w->D[j] = divisor(sqrt(square));
    }
    divide_columns(w, at->factor, L, L);
    for (int64_t j = 0; j < L; j++) {
        w->q[j] = -w->q[j];
        w->scale[j] = 0.0;
        w->step_low[j] *= w->D[j];
        w->step_high[j] *= w->D[j];
    }
    box_problem b = {w->trial.R, w->q, w->scale, w->step_low, w->step_high, L, 1, L};
    solve_in_box(&b, w->step, &w->solver);
    double more = square_norm(&b, w->step);
    for (int64_t j = 0; j < L; j++) w->step[j] /= w->D[j];
    return more;
}

int best_start(fitter *w, int64_t bracket) {
    const many_data *data = w->data;
    const level *level = data->tape->level;
    int64_t size = w->starts->size, L = data->linears, padded = whole(w->rows);
    double least = INFINITY;
    pad(w->residuals, w->rows);
    for (int64_t k = bracket * size; k < (bracket + 1) * size && !w->stopped; k++) {
        const double *theta = w->starts->starts + k * data->d;
        look at = look_at(w, k, theta);
        EACH_ROW for (int64_t i = 0; i < w->rows; i++) w->residuals[i] = w->y[i] - at.values[i];
        double total = level->product_sum(w->residuals, w->residuals, padded);
        for (int64_t j = 0; j < L; j++) {
            const double *basis = at.basis + j * w->longest;
            w->q[j] = level->product_sum(basis, w->residuals, padded);
            total -= w->q[j] * w->q[j];
        }
        if (!(total < least)) continue;
        total += solve_linear(w, &at, theta);
        if (!(total < least)) continue;
        least = total;
        copy(theta, w->solved, data->d);
        for (int64_t j = 0; j < L; j++) w->solved[data->linear[j]] += w->step[j];
    }
    return least < INFINITY;
}
