/* Levenberg-Marquardt descents within a box, of many small datasets one after the other. NumPy
   form, for all datasets side by side: miho/fitting/descents.py. */
#include <math.h>
#include <string.h>
#include "elementary.h"
#include "many_fit.h"

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
/* A descent is at a known minimum within this squared distance, in shares of its sum of squares and
   units of d / rows, or a share alone. */
#define NEAR 9.0
#define NEAR_LAST 0.1

static void set_units(const fitter *w, place *at) {
    const many_data *data = w->data;
    for (int64_t k = 0; k < data->d; k++) {
        double value = data->log[k] ? exp_one(at->x[k]) : at->x[k];
        at->theta[k] = at->x[k] <= w->low[k] ? data->low[k] : at->x[k] >= w->high[k]
            ? data->high[k] : between(data->low[k], value, data->high[k]);
    }
}

void set_coordinates(const fitter *w, const double *theta, double *x) {
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

void divide_columns(fitter *w, const double *R, int64_t side, int64_t n) {
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

void descend_from(fitter *w, const double *theta) {
    set_coordinates(w, theta, w->here.x);
    if (descend_here(w)) {
        w->ends[w->descents++] = w->best.squares;
        return;
    }
    w->ends[w->descents++] = w->here.squares;
    if (w->here.squares < w->best.squares) exchange(&w->here, &w->best);
}
