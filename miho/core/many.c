/* Levenberg-Marquardt descents within a box, of many small datasets one after the other. NumPy
   form, for all datasets side by side: miho/fitting/descents.py. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "elementary.h"
#include "many.h"

#define STEPS 200               /* per descent, at most */
#define DAMPING 1e-3            /* initial */
/* Ratios of gain to predicted gain above which the damping decreases, and below which it increases,
   and its factors. After a failed step it increases by a factor that doubles each time (Nielsen,
   1999). */
#define GOOD 0.75
#define POOR 0.25
#define LESS 0.1
#define MORE 2.0
#define RESTART_DAMPING 1e-6
#define SMALLEST_DAMPING 1e-12
#define LARGEST_DAMPING 1e10
#define FADING 0.3              /* largest decrease of a scale per step */
#define REACH 0.25              /* longest step, as a share of the box */
/* A step that gains, or promises, less than this share of the sum of squares is the last. If it
   promises less because of the damping, the damping decreases. */
#define STANDSTILL 1e-13
#define DONE_DAMPING 1e-3
#define TRIES 12
#define LEAST 1e-300
#define ROUNDING 3.5e-15        /* residuals below this share of the data are rounding */
/* A descent is at a known minimum within this squared distance, in shares of its sum of squares and
   units of d / rows, or a share alone. */
#define NEAR 9.0
#define NEAR_LAST 0.1
/* Evidence, see miho/optim/evidence.py. */
#define AGREEING 1e-4
#define ENOUGH 5
#define SHARE 0.25
#define BETTER 0.025
#define DEPENDENT 1e-7          /* smaller pivots, of columns of length 1, are dependent */
#define MOST_KEPT 4000000       /* stored values at common starts */

/* A configuration in search coordinates (logarithms of log-scale parameters) and in units; the
   triangular factor (d + 1, d + 1) of derivatives and residuals; and the sum of squares. */
typedef struct {
    double *x, *theta, *R, squares;
    int converged;
} place;

/* Values at a start (rows,), an orthonormal basis of the columns of the linear parameters (linears,
   rows), and their triangular factor (linears, linears) in it. */
typedef struct {
    double *values, *basis, *factor;
} look;

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

static void spend(fitter *w, double operations) {
    w->stopped = stops_after(operations, w->by);
}

static void set_units(const fitter *w, place *at) {
    const many_data *data = w->data;
    for (int64_t k = 0; k < data->d; k++) {
        double value = data->log[k] ? exp_one(at->x[k]) : at->x[k];
        at->theta[k] = at->x[k] <= w->low[k] ? data->low[k] : at->x[k] >= w->high[k]
            ? data->high[k] : between(data->low[k], value, data->high[k]);
    }
}

static void set_coordinates(const fitter *w, const double *theta, double *x) {
    for (int64_t k = 0; k < w->data->d; k++) {
        double value = between(w->data->low[k], theta[k], w->data->high[k]);
        x[k] = w->data->log[k] ? log_one(value) : value;
    }
}

/* Factor and sum of squares at a place, infinite if not finite. */
static void evaluate(fitter *w, place *at) {
    const many_data *data = w->data;
    int64_t d = data->d, side = d + 1, stride = w->stride;
    double *r = w->chunk + d * stride;
    memset(at->R, 0, (size_t)(side * side) * sizeof(double));
    at->squares = 0.0;
    set_units(w, at);
    tape_start(data->tape, at->theta, w->room);
    for (int64_t start = 0; start < w->rows && !w->stopped; start += CHUNK) {
        int64_t rows = w->rows - start < CHUNK ? w->rows - start : CHUNK;
        int64_t i = w->first + start;
        tape_continue(data->tape, data->X, data->N, i, i + rows, w->chunk, stride, w->room);
        for (int64_t k = 0; k < d; k++) {
            double *column = w->chunk + k * stride, factor = at->theta[k];
            if (data->log[k])
                EACH_ROW for (int64_t i = 0; i < rows; i++) column[i] *= factor;
        }
        EACH_ROW for (int64_t i = 0; i < rows; i++) r[i] -= w->y[start + i];
        for (int64_t k = 0; k < side; k++) pad(w->chunk + k * stride, rows);
        at->squares += data->tape->level->product_sum(r, r, whole(rows));
        data->tape->level->fold(at->R, side, w->chunk, stride, whole(rows), side, NULL);
        spend(w, (double)(rows * (data->tape->length + side * side)));
    }
    if (!isfinite(at->squares)) at->squares = INFINITY;
}

/* Scales from the norms of columns; 0 if a derivative is not finite. */
static int set_scales(fitter *w, double fading) {
    int64_t d = w->data->d, side = d + 1;
    for (int64_t k = 0; k < d; k++) {
        double square = 0.0;
        for (int64_t j = 0; j <= k; j++) {
            double value = w->here.R[j * side + k];
            square += value * value;
        }
        if (!isfinite(square)) return 0;
        w->D[k] = larger(sqrt(square), fading * w->D[k]);
    }
    return 1;
}

static double divisor(double scale) { return scale > 0.0 ? scale : 1.0; }

/* Write a triangular factor of n columns, divided by their scales, to the trial's, which is free:
   else the unit of one parameter could make another one seem to be without effect. */
static void divide_columns(fitter *w, const double *R, int64_t side, int64_t n) {
    for (int64_t k = 0; k < n; k++)
        for (int64_t row = 0; row <= k; row++)
            w->trial.R[row * side + k] = R[row * side + k] / divisor(w->D[k]);
}

/* Set the trial to the next step; returns the gain in the linear model, 0 if the descent is
   done. */
static double propose(fitter *w, double *damping) {
    int64_t d = w->data->d, side = d + 1;
    const double *x = w->here.x, *R = w->here.R;
    double square = 0.0;
    divide_columns(w, R, side, d);
    for (int64_t k = 0; k < d; k++) {
        double reach = REACH * (w->high[k] - w->low[k]), q = R[k * side + d];
        w->step_low[k] = divisor(w->D[k]) * larger(w->low[k] - x[k], -reach);
        w->step_high[k] = divisor(w->D[k]) * smaller(w->high[k] - x[k], reach);
        square += q * q;
    }
    box_problem b = {w->trial.R, R + d, w->scale, w->step_low, w->step_high, side, side, d};
    for (int count = 0; count < TRIES; count++) {
        double root = sqrt(*damping);
        for (int64_t k = 0; k < d; k++) w->scale[k] = root;
        solve_in_box(&b, w->step, &w->solver);
        double gain = square - square_norm(&b, w->step);
        if (!(gain > STANDSTILL * w->here.squares)) {
            if (*damping <= DONE_DAMPING) return 0.0;
            *damping *= LESS;
            continue;
        }
        int differs = 0;
        for (int64_t k = 0; k < d; k++) {
            double step = w->step[k], D = divisor(w->D[k]);
            double to = between(w->low[k], x[k] + step / D, w->high[k]);
            if (step <= D * (w->low[k] - x[k])) to = w->low[k];
            if (step >= D * (w->high[k] - x[k])) to = w->high[k];
            w->trial.x[k] = to;
            differs = differs || to != x[k];
        }
        return differs ? gain : 0.0;
    }
    return 0.0;
}

/* Whether a descent is on its way to the best minimum so far, and no better. */
static int nears_best(const fitter *w) {
    int64_t d = w->data->d, side = d + 1;
    const double *x = w->here.x, *R = w->here.R;
    if (!(w->best.squares <= w->here.squares)) return 0;
    double near = smaller(NEAR * (double)d / (double)w->rows, NEAR_LAST) * w->here.squares;
    double total = w->here.squares - w->best.squares;
    for (int64_t row = 0; row < d && total <= near; row++) {
        double value = 0.0;
        if (fabs(R[row * side + row]) <= DEPENDENT * w->D[row]) return 0;
        for (int64_t k = row; k < d; k++) value += R[row * side + k] * (x[k] - w->best.x[k]);
        total += value * value;
    }
    return total <= near;
}

static void exchange(place *a, place *b) {
    place kept = *a;
    *a = *b;
    *b = kept;
}

/* Descend from `here`, without prior evaluations; returns whether it came to the best minimum so
   far. */
static int descend_here(fitter *w) {
    double damping = DAMPING, growth = 2.0;
    evaluate(w, &w->here);
    w->here.converged = 0;
    if (!isfinite(w->here.squares) || !set_scales(w, 0.0)) return 0;
    for (int steps = 0; steps < STEPS && !w->stopped; steps++) {
        if (w->here.squares <= w->zero) break;
        if (nears_best(w)) return 1;
        double predicted = propose(w, &damping);
        if (!(predicted > 0.0)) break;
        evaluate(w, &w->trial);
        double before = w->here.squares, gain = before - w->trial.squares;
        int last = fabs(gain) <= STANDSTILL * (before + LEAST);
        if (gain > 0.0) {
            exchange(&w->here, &w->trial);
            if (!set_scales(w, FADING)) return 0;
            if (gain > GOOD * predicted) damping = larger(LESS * damping, SMALLEST_DAMPING);
            else if (gain < POOR * predicted) damping *= MORE;
            growth = 2.0;
        } else {
            damping = larger(damping * growth, RESTART_DAMPING);
            growth *= 2.0;
        }
        int stuck = damping > LARGEST_DAMPING;
        /* Where the formula has no value beyond, it may fall along the edge. */
        if (stuck && !isfinite(w->trial.squares)) return 0;
        if (last || stuck) break;
        if (steps == STEPS - 1) return 0;
    }
    w->here.converged = !w->stopped;
    return 0;
}

/* Descend from a configuration in units, and keep the better minimum. */
static void descend_from(fitter *w, const double *theta) {
    set_coordinates(w, theta, w->here.x);
    if (descend_here(w)) {
        w->ends[w->descents++] = w->best.squares;
        return;
    }
    w->ends[w->descents++] = w->here.squares;
    if (w->here.squares < w->best.squares) exchange(&w->here, &w->best);
}

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

/* Write the start of a bracket with the lowest sum of squares over its linear parameters to
   w.solved; 0 if none is finite. */
static int best_start(fitter *w, int64_t bracket) {
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
