/* Small least-squares problems by orthogonal transformations. */
#include <math.h>
#include "search.h"

/* A pivot below this share of the largest pivot, or of its column, counts as 0: its parameter
   depends on the previous ones, and stays unchanged while the same others are free. */
#define SINGULAR 1e-14
/* Marks such a parameter; free parameters have 1, parameters at a bound 0. */
#define DEPENDENT 0.5

/* One row of R s + q. */
static double row_of(const box_problem *b, const double *s, int64_t row) {
    double value = 0.0;
    for (int64_t k = row; k < b->n; k++) value += b->R[row * b->side + k] * s[k];
    return value + b->q[row * b->step];
}

/* |R s + q|^2. */
double square_norm(const box_problem *b, const double *s) {
    double total = 0.0;
    for (int64_t row = 0; row < b->n; row++) {
        double value = row_of(b, s, row);
        total += value * value;
    }
    return total;
}

/* Factor of the free parameters, the others fixed, into room->T; returns their number. */
static int64_t factor_of_free(const box_problem *b, const double *s, const solver_room *room) {
    int64_t n = b->n, stride = whole(2 * n), side = room->d + 1, count = 0;
    memset(room->columns, 0, (size_t)((n + 1) * stride) * sizeof(double));
    for (int64_t k = 0; k < n; k++) {
        if (room->free[k] != 1.0) continue;
        double *column = room->columns + count++ * stride;
        for (int64_t row = 0; row <= k; row++) column[row] = b->R[row * b->side + k];
        column[n + k] = b->scale[k];
    }
    double *last = room->columns + count * stride;
    for (int64_t row = 0; row < n; row++) {
        double right = b->q[row * b->step];
        for (int64_t k = row; k < n; k++)
            if (room->free[k] != 1.0) right += b->R[row * b->side + k] * s[k];
        last[row] = right;
    }
    memset(room->T, 0, (size_t)((count + 1) * side) * sizeof(double));
    room->level->fold(room->T, side, room->columns, stride, whole(2 * n), count + 1, room->by);
    return count;
}

/* Whether no free parameter depends on previous ones; marks the first that does. The factor must
   then be computed again without it: its column has only rounding left, but uses a row of the
   factor. */
static int independent(int64_t n, int64_t count, const solver_room *room) {
    int64_t side = room->d + 1, j = 0;
    double largest = 0.0;
    for (int64_t k = 0; k < count; k++) largest = larger(largest, fabs(room->T[k * side + k]));
    for (int64_t k = 0; k < n; k++) {
        if (room->free[k] != 1.0) continue;
        double norm = 0.0;
        for (int64_t row = 0; row <= j; row++) norm = larger(norm, fabs(room->T[row * side + j]));
        if (fabs(room->T[j * side + j]) <= SINGULAR * larger(largest, norm)) {
            room->free[k] = DEPENDENT;
            return 0;
        }
        j++;
    }
    return 1;
}

/* Minimum of the free parameters into room->solution, without dependent ones. */
static void solve_free(const box_problem *b, const double *s, const solver_room *room) {
    int64_t n = b->n, side = room->d + 1;
    double *solution = room->solution;
    const double *T = room->T;
    for (int64_t k = 0; k < n; k++)
        if (room->free[k] == DEPENDENT) room->free[k] = 1.0;
    int64_t count = factor_of_free(b, s, room);
    while (!stops_after(0.0, room->by) && !independent(n, count, room))
        count = factor_of_free(b, s, room);
    for (int64_t j = count - 1; j >= 0; j--) {
        double right = -T[j * side + count];
        for (int64_t k = j + 1; k < count; k++) right -= T[j * side + k] * solution[k];
        solution[j] = right / T[j * side + j];
    }
}

/* Move the free parameters to their minimum, and parameters that leave the box to its bounds. With
   `stop` they move on the straight line to the minimum up to the first bound. Parameters that reach
   a bound are fixed there; returns whether any did. */
static int minimise_free(const box_problem *b, double *s, int stop, const solver_room *room) {
    const double *low = b->low, *high = b->high, *solution = room->solution;
    solve_free(b, s, room);
    if (stops_after(0.0, room->by)) return 0;
    /* Share of the step up to the first bound. */
    double share = 1.0;
    for (int64_t k = 0, j = 0; k < b->n; k++) {
        if (room->free[k] != 1.0) continue;
        double to = solution[j++], bound = between(low[k], to, high[k]);
        if (stop && bound != to) share = smaller(share, (bound - s[k]) / (to - s[k]));
    }
    /* Make the step, and fix parameters that reach a bound. */
    int fixed = 0;
    for (int64_t k = 0, j = 0; k < b->n; k++) {
        if (room->free[k] != 1.0) continue;
        double to = solution[j++], bound = between(low[k], to, high[k]);
        if (bound != to && (!stop || (bound - s[k]) / (to - s[k]) <= share)) {
            s[k] = bound;
            room->free[k] = 0.0;
            fixed = 1;
        } else if (share < 1.0) {
            s[k] = between(low[k], s[k] + share * (to - s[k]), high[k]);
        } else {
            s[k] = to;
        }
    }
    return fixed;
}

/* Fixed parameter with the steepest inward gradient, -1 if none. */
static int64_t steepest_inwards(const box_problem *b, const double *s, const solver_room *room) {
    double steepest = 0.0;
    int64_t found = -1;
    for (int64_t k = 0; k < b->n; k++) {
        if (room->free[k] != 0.0) continue;
        if (stops_after((double)(k * b->n), room->by)) return -1;
        double slope = b->scale[k] * b->scale[k] * s[k];
        for (int64_t row = 0; row <= k; row++)
            slope += b->R[row * b->side + k] * row_of(b, s, row);
        int inward = s[k] <= b->low[k] ? slope < 0 : slope > 0;
        if (inward && fabs(slope) > steepest) {
            steepest = fabs(slope);
            found = k;
        }
    }
    return found;
}

/* Active-set method. First, all parameters that the solution would take out of the box are fixed at
   its bounds at once, and the others are solved again. Then the fixed parameter with the steepest
   inward gradient is freed, and the step to the new solution ends at the first bound, so that each
   step decreases the sum of squares, until the Karush-Kuhn-Tucker conditions hold (Stark and
   Parker, Computational Statistics 10, 1995), or 3 n parameters were freed. After a stop the result
   is of no use. */
void solve_in_box(const box_problem *b, double *s, const solver_room *room) {
    for (int64_t k = 0; k < b->n; k++) {
        s[k] = 0.0;
        room->free[k] = 1.0;
    }
    while (minimise_free(b, s, 0, room)) { }
    for (int64_t count = 0; count < 3 * b->n; count++) {
        int64_t k = steepest_inwards(b, s, room);
        if (k < 0) return;
        room->free[k] = 1.0;
        while (minimise_free(b, s, 1, room)) { }
    }
}
